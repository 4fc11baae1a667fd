import pytest

from scan3d_twin.core.errors import FileError
from scan3d_twin.run.folder import (
    claim_folder,
    find_free_folder,
    fresh_part,
    release_folder,
    write_file,
    write_inside,
)


def test_a_claimed_folder_exists_and_is_empty(tmp_path):
    folder = claim_folder(tmp_path / "a" / "b")
    assert folder.is_dir()
    assert list(folder.iterdir()) == []


def test_an_empty_folder_may_be_claimed_again(tmp_path):
    assert claim_folder(claim_folder(tmp_path / "a")) == tmp_path / "a"


def test_a_folder_with_something_in_it_is_refused_and_left_alone(tmp_path):
    (tmp_path / "precious").write_text("x")
    with pytest.raises(FileError, match="is not empty"):
        claim_folder(tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["precious"]


def test_a_folder_below_a_file_cannot_be_claimed(tmp_path):
    (tmp_path / "file").write_text("x")
    with pytest.raises(FileError, match=r"cannot write to .*Not a directory"):
        claim_folder(tmp_path / "file" / "run")


def test_a_file_is_replaced_as_a_whole(tmp_path):
    path = tmp_path / "sub" / "x.json"
    write_file(path, "long text that is there before")
    write_file(path, b"new")
    assert path.read_bytes() == b"new"
    assert [each.name for each in path.parent.iterdir()] == ["x.json"]


def test_writing_below_a_file_is_a_file_error(tmp_path):
    (tmp_path / "file").write_text("x")
    with pytest.raises(FileError, match="cannot write"):
        write_file(tmp_path / "file" / "x", "y")


def test_a_free_folder_does_not_exist_yet(tmp_path):
    assert find_free_folder(tmp_path / "r") == tmp_path / "r"
    (tmp_path / "r").mkdir()
    (tmp_path / "r-2").mkdir()
    assert find_free_folder(tmp_path / "r") == tmp_path / "r-3"


def test_only_an_empty_folder_is_released(tmp_path):
    for name in ("empty", "full"):
        (tmp_path / name).mkdir()
    (tmp_path / "full" / "x").write_text("x")
    release_folder(tmp_path / "empty")
    release_folder(tmp_path / "full")
    assert [path.name for path in tmp_path.iterdir()] == ["full"]


def test_nothing_is_written_through_a_link(tmp_path):
    """A run's folder from elsewhere may hold any links."""
    mine = tmp_path / "mine.txt"
    mine.write_text("precious")
    run = tmp_path / "run"
    run.mkdir()
    for name in ("report.json", "report.json.part"):
        (run / name).symlink_to(mine)
    write_file(run / "report.json", "{}")
    assert mine.read_text() == "precious"
    assert (run / "report.json").read_text() == "{}"
    assert not (run / "report.json").is_symlink()


def test_a_link_is_no_folder_of_a_run(tmp_path):
    (tmp_path / "mine").mkdir()
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / "views").symlink_to(tmp_path / "mine")
    with pytest.raises(FileError, match="views is a link to another place; remove it"):
        write_inside(tmp_path / "run", tmp_path / "run" / "views" / "000.npz", b"view")
    assert list((tmp_path / "mine").iterdir()) == []


def test_a_run_may_lie_behind_a_link(tmp_path):
    (tmp_path / "disk").mkdir()
    (tmp_path / "run").symlink_to(tmp_path / "disk")
    write_inside(tmp_path / "run", tmp_path / "run" / "views" / "000.npz", b"view")
    assert (tmp_path / "disk" / "views" / "000.npz").read_bytes() == b"view"


@pytest.mark.parametrize("error", [OSError(28, "No space left on device"), KeyboardInterrupt()])
def test_a_file_that_cannot_be_finished_leaves_nothing(tmp_path, error):
    def fail_halfway():
        with fresh_part(tmp_path / "x.json") as part:
            part.write_text("half")
            raise error

    with pytest.raises(type(error)):
        fail_halfway()
    assert list(tmp_path.iterdir()) == []
