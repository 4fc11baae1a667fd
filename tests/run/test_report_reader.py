"""Reports of others: each value of another type is refused in one line, at the door."""

import copy
import json

import pytest

from scan3d_twin.core.errors import FileError
from scan3d_twin.core.model.evaluation import Distances, Evaluation
from scan3d_twin.core.model.pose_errors import PairError
from scan3d_twin.run.report import Effort, Journey, build_report, report_json
from scan3d_twin.run.report_reader import MAX_SIZE, read_report
from scan3d_twin.run.settings import Settings
from scan3d_twin.run.strict_json import parse_json

ODD = (None, "text", [], [None], {}, True, 1.5, -1, 10**400, "\ud800")
"""Values of any type; each field takes some of them."""


@pytest.fixture(scope="module")
def report(session):
    """A report with a value in each field."""
    three = Distances(0.005, 0.004, 0.011)
    evaluation = Evaluation(
        0.9, (0.7, 0.9), three, three, {0.010: 0.7, 0.020: 0.9, 0.030: 0.95}, 0.6,
        (PairError(1, 0.0042, 0.0051, 0.0301),),
    )  # fmt: skip
    return build_report(
        "boxes", Settings(config=session.config), session, Journey(2.5, 3.0, 90.0),
        Effort(4.0, 0.5, 2e8), 123, evaluation, three, ("A warning.",),
    )  # fmt: skip


def places(tree, above=()):
    """Yield the way to each value in ``tree``."""
    items = tree.items() if isinstance(tree, dict) else enumerate(tree)
    for key, value in items:
        yield (*above, key)
        if isinstance(value, dict | list):
            yield from places(value, (*above, key))


def changed(report, place, value):
    """Return ``report`` with another ``value`` at ``place``."""
    result = copy.deepcopy(report)
    inner = result
    for key in place[:-1]:
        inner = inner[key]
    inner[place[-1]] = value
    return result


def test_a_report_is_read_as_it_was_written(report, tmp_path):
    (tmp_path / "report.json").write_text(report_json(report), encoding="utf-8")
    assert read_report(tmp_path / "report.json") == json.loads(report_json(report))


def test_every_value_is_of_its_type_or_the_report_is_refused(report, tmp_path):
    path, refused = tmp_path / "report.json", 0
    kinds = {place: type(value_at(report, place)) for place in places(report)}
    for place, kind in kinds.items():
        known = {kind} if kind in (int, str, bool, list, dict) else {int, float}
        for odd in ODD:
            path.write_text(json.dumps(changed(report, place, odd)))
            try:
                found = read_report(path)
            except FileError:
                refused += 1
                continue
            read = value_at(found, place)
            assert read == odd
            assert read is None or type(read) in known
            assert odd != "\ud800"
    assert refused > 5 * len(kinds)


def value_at(tree, place):
    """Return the value at ``place``."""
    for key in place:
        tree = tree[key]
    return tree


def test_whole_numbers_may_be_written_as_fractions(tmp_path):
    (tmp_path / "report.json").write_text('{"views": 2.0, "path_m": 3, "of_later": [{}]}')
    read = read_report(tmp_path / "report.json")
    assert (read, type(read["views"])) == ({"views": 2, "path_m": 3}, int)


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("[]", "the report is"),
        ('{"views": 2', "delimiter"),
        ('{"path_m": NaN}', "NaN is not JSON"),
        ('{"path_m": 1e999}', "path_m is inf"),
        ('{"registration": [{"error_mm": 3}]}', "a registration of no view"),
        ('{"a": ' + "[" * 5000 + "]" * 5000 + "}", "nested too deeply"),
        ("{" + " " * MAX_SIZE + "}", "more than 1 MB"),
    ],
)
def test_what_is_no_report_is_refused_with_the_reason(tmp_path, text, reason):
    (tmp_path / "report.json").write_text(text)
    with pytest.raises(FileError, match=reason) as refused:
        read_report(tmp_path / "report.json")
    assert len(str(refused.value).splitlines()) == 1


def test_a_text_that_cannot_be_written_again_is_refused():
    assert parse_json('"\\ud83d\\ude00 \\\\ud800"') == "\N{GRINNING FACE} \\ud800"
    for text in ('"\\ud800"', '{"\\uDFFF": 1}', '["\\ude00\\ud83d"]', b'"\xff"'):
        with pytest.raises(ValueError):
            parse_json(text)
