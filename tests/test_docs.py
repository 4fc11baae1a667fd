"""README, pages and examples as a reader gets them: they run, lead somewhere and stay offline."""

import ast
import json
import re
import runpy
import sys
from pathlib import Path

import pytest
from short_runs import COARSE_OPTIONS

import scan3d_twin
from scan3d_twin.api.sim import run_sim
from scan3d_twin.cli.app import COMMANDS
from scan3d_twin.run.settings import merge_options

ROOT = Path(__file__).resolve().parents[1]
README = (ROOT / "README.md").read_text(encoding="utf-8")
PAGES = sorted([*ROOT.glob("*.md"), *ROOT.glob("docs/*.md"), *ROOT.glob("docs/decisions/*.md")])
TRAINING = "train_ppo.py"
"""Takes a quarter of an hour and a package that is not installed: never part of the tests."""
EXAMPLES = sorted(path for path in (ROOT / "examples").glob("*.py") if path.name != TRAINING)


def python_blocks(page: Path) -> list[str]:
    """Return the Python code that a page shows."""
    return re.findall(r"```python\n(.*?)```", page.read_text(encoding="utf-8"), flags=re.DOTALL)


def imported_modules(code: str) -> set[str]:
    """Return the modules of this package that ``code`` names in its imports."""
    names: set[str] = set()
    for node in ast.walk(ast.parse(code)):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            names.add(node.module or "")
    return {name for name in names if name.split(".")[0] == "scan3d_twin"}


BLOCKS = python_blocks(ROOT / "README.md")


@pytest.mark.timeout(600)
@pytest.mark.parametrize("code", BLOCKS, ids=range(len(BLOCKS)))
def test_the_readmes_code_runs_as_written(code, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    exec(compile(code, "README.md", "exec"), {})
    assert 0.8 < float(capsys.readouterr().out) <= 1.0


def test_the_readme_is_short_and_its_code_has_five_lines():
    assert len(README.splitlines()) <= 120
    assert [len(code.splitlines()) for code in BLOCKS] == [5]
    assert README.index(BLOCKS[0]) < README.index("\n## ")


def test_the_first_pages_repeat_the_readmes_code():
    for name in ("index", "quickstart"):
        assert BLOCKS[0] in python_blocks(ROOT / "docs" / f"{name}.md")


def run_coarsely(scene, *, options=None, **given):
    """Digitise ``scene`` as ``run_sim`` does, with coarse sweeps."""
    return run_sim(scene, options=merge_options([COARSE_OPTIONS, options or {}]), **given)


@pytest.mark.timeout(600)
@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_the_examples_run_and_are_short(path, tmp_path, monkeypatch, capsys):
    """As they are, but that runs take coarse sweeps; `make docs` runs them with their own."""
    assert len(path.read_text().splitlines()) < 60
    monkeypatch.setattr(scan3d_twin, "run_sim", run_coarsely)
    monkeypatch.setattr(sys, "argv", [path.name, str(tmp_path)])
    runpy.run_path(str(path), run_name="__main__")
    assert "points" in capsys.readouterr().out
    assert list(tmp_path.iterdir())


CODE = {
    f"{page.relative_to(ROOT)}-{k}": code
    for page in [ROOT / "README.md", *ROOT.glob("docs/*.md")]
    for k, code in enumerate(python_blocks(page))
} | {f"examples/{path.name}": path.read_text() for path in (ROOT / "examples").glob("*.py")}


NOTEBOOKS = {
    path.name: json.loads(path.read_text(encoding="utf-8"))["cells"]
    for path in (ROOT / "docs").glob("*.ipynb")
}
"""The notebooks, which `make docs` runs."""
CODE |= {
    f"{name}-{k}": "".join(cell["source"])
    for name, cells in NOTEBOOKS.items()
    for k, cell in enumerate(cells)
    if cell["cell_type"] == "code"
}


@pytest.mark.parametrize("name", NOTEBOOKS)
def test_a_notebook_is_kept_as_it_is_before_it_runs(name):
    code = [cell for cell in NOTEBOOKS[name] if cell["cell_type"] == "code"]
    assert len(code) >= 5
    for cell in code:
        assert (cell["outputs"], cell["execution_count"]) == ([], None)


@pytest.mark.parametrize("name", [name for name in CODE if "extending" not in name])
def test_code_for_users_needs_the_front_door_only(name):
    assert imported_modules(CODE[name]) <= {"scan3d_twin"}


def test_the_reference_has_every_public_name():
    listed = re.findall(
        r"^\.\. auto\w+:: scan3d_twin\.(\w+)$", (ROOT / "docs/api.md").read_text(), re.MULTILINE
    )
    assert sorted(listed) == sorted(scan3d_twin.__all__)


LINKS = {
    (page.relative_to(ROOT), target)
    for page in PAGES
    for target in re.findall(
        r"""\]\(([^)#\s]+)|<img src="([^"]+)""", page.read_text(encoding="utf-8")
    )
    for target in target
    if target and "://" not in target
}


@pytest.mark.parametrize(("page", "target"), sorted(LINKS), ids=str)
def test_links_between_pages_lead_somewhere(page, target):
    assert ((ROOT / page).parent / target).exists()


NAMED = {
    (page.relative_to(ROOT), path)
    for page in PAGES
    for path in re.findall(r"`((?:\w+/)+\w+\.py)`", page.read_text(encoding="utf-8"))
    if page.name != "extending.md"
}
"""Files of the project by the pages that name them; some pages start at the package or its core.
The page on extending names those of another package."""


@pytest.mark.parametrize(("page", "path"), sorted(NAMED), ids=str)
def test_files_that_pages_name_exist(page, path):
    homes = (".", "scan3d_twin", "scan3d_twin/core", "scan3d_twin/core/registration")
    assert any((ROOT / home / path).exists() for home in homes)


FIGURE = r"""!\[[^\]]*\]\(([^)\s]+\.(?:png|svg|gif))\)|<img src="([^"]+)"|```\{image\} (\S+)"""
FIGURES = [
    (page.relative_to(ROOT), "".join(found.groups("")), text[found.end() :])
    for page in PAGES
    for text in [page.read_text(encoding="utf-8")]
    for found in re.finditer(FIGURE, text)
]
"""Figures by the pages that show them, with the text after them."""


@pytest.mark.parametrize(
    ("page", "figure", "text"), FIGURES, ids=[f"{page}-{name}" for page, name, _ in FIGURES]
)
def test_under_each_figure_stands_the_command_that_makes_it(page, figure, text):
    assert ((ROOT / page).parent / figure).exists()
    below = re.split(FIGURE, text)[0]
    (program, name), *_ = re.findall(r"[Mm]ade by `(\w+) ([^\s`]+)", below)
    if program == "twin":
        assert name in COMMANDS
    else:
        assert program == "python"
        assert Path(figure).name in (ROOT / name).read_text(encoding="utf-8")


@pytest.fixture
def offline(monkeypatch):
    """The check that ends the build of the site."""
    monkeypatch.syspath_prepend(ROOT / "docs" / "_extensions")
    import offline

    return offline


@pytest.mark.parametrize(
    "html",
    [
        '<script src="https://cdn.example/x.js"></script>',
        '<link rel="stylesheet" href="//fonts.example/css">',
        '<link rel="preconnect" href="https://fonts.example">',
        '<img src="a.png" srcset="a.png 1x, https://images.example/a.png 2x">',
        '<div style="background: url(https://images.example/a.png)"></div>',
        '<style>@import "https://fonts.example/css";</style>',
        '<svg><image xlink:href="http://images.example/a.png"/></svg>',
    ],
)
def test_a_page_that_loads_from_another_host_is_noticed(offline, html):
    assert len(offline.requests_of_page(html)) == 1


def test_links_to_follow_and_own_files_are_no_requests(offline):
    html = (
        '<a href="https://docs.example">docs</a><link rel="canonical" href="https://docs.example">'
        '<img src="data:image/png;base64,AA"><script src="_static/a.js"></script>'
        '<p>url(https://docs.example)</p><style>a { background: url("b.png") }</style>'
    )
    assert offline.requests_of_page(html) == []
