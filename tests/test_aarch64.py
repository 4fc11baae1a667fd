"""The robot's computer is often an ARM64 one: every locked dependency has a wheel for it.

Read from the lock file, so it needs no network: what a resolver does, for one platform.
"""

import tomllib
from pathlib import Path

import pytest
from packaging.markers import Marker
from packaging.tags import Tag, cpython_tags
from packaging.utils import parse_wheel_filename

LOCK = tomllib.loads((Path(__file__).resolve().parents[1] / "uv.lock").read_text())
NEWEST_GLIBC = 28
"""glibc 2.28: Debian 10, Ubuntu 20.04 and Raspberry Pi OS 10 and later."""


def environment(minor):
    """Return what markers see on Linux on ARM64."""
    return {
        "implementation_name": "cpython",
        "implementation_version": f"3.{minor}.0",
        "os_name": "posix",
        "platform_machine": "aarch64",
        "platform_python_implementation": "CPython",
        "platform_release": "",
        "platform_system": "Linux",
        "platform_version": "",
        "python_full_version": f"3.{minor}.0",
        "python_version": f"3.{minor}",
        "sys_platform": "linux",
        "extra": "",
    }


def tags(minor):
    """Return the tags of the wheels that can be installed there."""
    old = ["manylinux2014_aarch64", "linux_aarch64"]
    platforms = [f"manylinux_2_{glibc}_aarch64" for glibc in range(NEWEST_GLIBC, 16, -1)] + old
    generic = {Tag(f"py{python}", "none", "any") for python in ("3", "2", f"3{minor}")}
    pure = {Tag(f"py{python}", "none", p) for python in ("3", f"3{minor}") for p in platforms}
    return {*cpython_tags((3, minor), platforms=platforms), *generic, *pure}


def needed(minor):
    """Return the locked packages of a base installation."""
    found, todo = {}, [(locked({"name": "scan3d-twin"}), ())]
    while todo:
        package, extras = todo.pop()
        wanted = list(package.get("dependencies", []))
        for extra in extras:
            wanted += package.get("optional-dependencies", {}).get(extra, [])
        for each in wanted:
            marker = each.get("marker")
            if marker and not Marker(marker).evaluate(environment(minor)):
                continue
            if each["name"] not in found or each.get("extra"):
                found[each["name"]] = locked(each)
                todo.append((locked(each), tuple(each.get("extra", ()))))
    return found


def locked(dependency):
    """Return the package that is meant; where several versions are locked it says which."""
    (package,) = (
        each
        for each in LOCK["package"]
        if each["name"] == dependency["name"]
        and each["version"] == dependency.get("version", each["version"])
    )
    return package


@pytest.mark.parametrize("minor", [11, 12, 13])
def test_every_dependency_has_a_wheel_for_arm64(minor):
    found, usable = needed(minor), tags(minor)
    assert {"mujoco-core", "numpy", "scipy", "pyserial"} <= set(found)
    assert "embreex" not in found  # MuJoCo casts the rays there
    without = [
        name
        for name, package in found.items()
        if not any(
            parse_wheel_filename(wheel["url"].rsplit("/", 1)[-1])[3] & usable
            for wheel in package.get("wheels", [])
        )
    ]
    assert without == []


def test_a_package_without_such_a_wheel_would_be_noticed():
    (embreex,) = (each for each in LOCK["package"] if each["name"] == "embreex")
    names = [wheel["url"].rsplit("/", 1)[-1] for wheel in embreex["wheels"]]
    assert names
    assert not any(parse_wheel_filename(name)[3] & tags(11) for name in names)
