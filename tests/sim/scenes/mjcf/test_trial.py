"""Limits of scene files: harmless scenes under limits that are lowered until they count."""

import pytest

from scan3d_twin.core.errors import SceneError
from scan3d_twin.limits import VARIABLE, limit_factor, scaled
from scan3d_twin.sim.embree import lifted_memory_limit
from scan3d_twin.sim.scenes.load import load_scene
from scan3d_twin.sim.scenes.mjcf import trial

SCENE = """<mujoco><worldbody><site name="spawn"/>
<body name="target" pos="1.5 0 0.2"><geom type="box" size="0.2 0.2 0.2"/></body>{more}
</worldbody></mujoco>"""
MORE = '<replicate count="20" offset="0 0.1 0"><geom size="0.02" pos="3 0 0.1"/></replicate>'
SHEET = "v 0 0 0\nv 1 0 0\nv 0 0.1 1\nv 1 0 1\nf 1 2 3\nf 2 4 3\n"


@pytest.fixture
def scene(tmp_path):
    """A scene with a few spheres that are made by replication."""
    path = tmp_path / "scene.xml"
    path.write_text(SCENE.format(more=MORE))
    return path


def test_a_scene_that_expands_a_little_is_read(scene):
    assert load_scene(str(scene)).model.ngeom == 22


def test_memory_is_limited_and_the_cure_is_named(scene, monkeypatch):
    monkeypatch.setattr(trial, "MAX_MEMORY", 1000)
    with pytest.raises(SceneError, match=rf"takes more than .*set {VARIABLE}=4$"):
        load_scene(str(scene))


@pytest.mark.parametrize("size", ['memory="5G"', 'nconmax="2000000" njmax="2000000"'])
def test_memory_that_a_file_only_asks_for_does_not_count(scene, size):
    scene.write_text(scene.read_text().replace("<worldbody>", f"<size {size}/><worldbody>", 1))
    assert load_scene(str(scene)).model.ngeom == 22


def test_embree_gets_its_memory_while_a_file_is_read(scene):
    """Where it lacks memory, it crashes."""
    limit, soft = trial.resource.RLIMIT_AS, []
    with trial.limited_memory(scene):
        soft.append(trial.resource.getrlimit(limit)[0])
        with lifted_memory_limit():
            soft.append(trial.resource.getrlimit(limit)[0])
        soft.append(trial.resource.getrlimit(limit)[0])
    assert soft[0] == soft[2] != soft[1] == trial.resource.getrlimit(limit)[1]


def test_time_is_limited(scene, monkeypatch):
    """The child takes the time that another program would: it waits in a loop."""
    monkeypatch.setattr(trial, "MAX_TIME", 0.2)
    monkeypatch.setattr(trial, "_CHILD", trial._CHILD.replace("try:", "while True: pass\ntry:"))
    with pytest.raises(SceneError, match=r"takes longer than 0\.2 s to read; if you trust it"):
        load_scene(str(scene))


def test_a_scene_that_cannot_expand_needs_no_trial(tmp_path, monkeypatch):
    def refuse(*_, **__):
        raise AssertionError("a child was started")

    monkeypatch.setattr(trial.subprocess, "run", refuse)
    path = tmp_path / "scene.xml"
    path.write_text(SCENE.format(more=""))
    assert load_scene(str(path)).model.ngeom == 2
    path.write_text(SCENE.format(more=MORE))
    with pytest.raises(AssertionError, match="a child was started"):
        load_scene(str(path))


@pytest.mark.parametrize("name", ["scene.xml", "mesh.obj"])
def test_a_file_may_not_be_too_large_unless_it_is_trusted(tmp_path, monkeypatch, name):
    path = tmp_path / name
    path.write_text(SCENE.format(more="") if name == "scene.xml" else SHEET)
    monkeypatch.setattr(trial, "MAX_FILE", path.stat().st_size // 2)
    with pytest.raises(SceneError, match=f"or if you trust it, set {VARIABLE}=4"):
        load_scene(str(path))
    monkeypatch.setenv(VARIABLE, "4")
    assert load_scene(str(path)).targets


def test_a_mesh_may_not_take_much_more_memory(tmp_path, monkeypatch):
    path = tmp_path / "mesh.obj"
    path.write_text(SHEET)
    load_scene(str(path))
    before = trial.resource.getrlimit(trial.resource.RLIMIT_AS)

    def run_out():
        with trial.limited_memory(path):
            raise MemoryError

    with pytest.raises(SceneError, match=r"mesh\.obj takes more than 0\.9 GB"):
        run_out()
    with trial.limited_memory(path):
        assert trial.resource.getrlimit(trial.resource.RLIMIT_AS) != before
    assert trial.resource.getrlimit(trial.resource.RLIMIT_AS) == before


@pytest.mark.parametrize(
    ("text", "factor"), [("4", 4.0), ("0.5", 0.5), ("x", 1.0), ("nan", 1.0), ("-1", 1.0)]
)
def test_the_environment_scales_all_limits(monkeypatch, text, factor):
    monkeypatch.setenv(VARIABLE, text)
    assert limit_factor() == factor
    assert scaled(1000) == int(1000 * factor)


def test_a_scene_is_utf_8_outside_its_comments(tmp_path):
    path = tmp_path / "scene.xml"
    path.write_bytes(SCENE.format(more="<!-- \xe9 -->").encode("latin-1"))
    assert load_scene(str(path)).targets
    path.write_bytes(SCENE.format(more='<geom name="\xe9" size="0.1"/>').encode("latin-1"))
    with pytest.raises(SceneError, match=r"is not valid MJCF: .*save it as UTF-8"):
        load_scene(str(path))
