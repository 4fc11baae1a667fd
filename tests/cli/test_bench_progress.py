import io
from dataclasses import replace

import pytest
from rich.console import Console
from rich.progress import Progress

from scan3d_twin.bench.spec import list_tasks, make_experiment
from scan3d_twin.cli.bench_progress import LiveProgress, bench_progress, run_words


@pytest.fixture(scope="module")
def lost():
    (task,) = list_tasks(make_experiment(["three_boxes"], [], ["best"]))
    return task.lost_record("not finished after 9 s", 3)


def test_off_a_terminal_each_run_is_a_line_with_the_time_left(lost, capsys):
    with bench_progress(4, 2) as told:
        told.done(lost)
        told.done(lost)
        assert told.count == 4
    first, one, two = capsys.readouterr().err.splitlines()
    assert first == "2 of 4 runs are done already"
    assert one.startswith("3/4, 0 s left: three_boxes best seed 0: LOST, not finished after 9 s")
    assert two.startswith("4/4, 0 s left: ")


def test_on_a_terminal_a_bar_moves_and_lost_runs_are_told(lost):
    screen = io.StringIO()
    console = Console(file=screen, force_terminal=True, width=100, highlight=False)
    with Progress(console=console) as bar:
        told = LiveProgress(bar, bar.add_task("runs", total=4, completed=2), 2)
        told.done(lost)
        assert bar.tasks[0].completed == told.count == 3
    assert "LOST, not finished after 9 s" in screen.getvalue()


def test_a_run_is_told_by_its_views_and_worst_error(lost):
    done = replace(lost, status="done", views=4, max_error=0.0042, coverage=0.871)
    assert (
        run_words(done)
        == "three_boxes best seed 0: 4 views, worst error 4.2 mm, surface 87% covered"
    )
    assert "worst error -," in run_words(replace(done, max_error=None))
