"""The inputs of benchmarks/fuzz.py: right files, and how they are changed and read."""

from __future__ import annotations

import importlib
import io
import json
import re
import struct
import zipfile
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from random import Random
from typing import Any

import numpy as np

Read = Callable[[Path], None]
NUMBERS = (
    "0", "-1", "1e308", "-1e308", "nan", "inf", "1e-320", "9" * 30, "9" * 5000, "0x10", "1.5",
    "2147483648", "-2147483649", "18446744073709551616", '"text"', "true", "null", "[]", "{}", '""',
    "[[1, 2], [3]]",
)  # fmt: skip
"""Values that stand where a number, a word or a list is wanted."""


@dataclass(frozen=True)
class Kind:
    """A kind of file: how an input is made from the right ones, and how it is read."""

    name: str
    make: Callable[[Path, Random, Path], Path]
    read: Read


READERS = (
    "scan3d_twin.bench.reporting.files", "scan3d_twin.bench.spec", "scan3d_twin.bench.store",
    "scan3d_twin.core.model.fused_cloud", "scan3d_twin.recording.repair.recover",
    "scan3d_twin.recording.scans", "scan3d_twin.sim.robot", "scan3d_twin.sim.scenes.load",
    "scipy.stats", "trimesh", "trimesh.exchange.load",
)  # fmt: skip
"""Modules that read files: loaded before the children are made, so that none loads them again."""


def make_base(folder: Path) -> Path:
    """Write a right file of each kind into ``folder`` and return it."""
    for name in READERS:
        importlib.import_module(name)
    import synthetic
    from recorded import record

    from scan3d_twin.bench.store import write_parquet
    from scan3d_twin.core.config import Config
    from scan3d_twin.core.digitize import integrate
    from scan3d_twin.core.session import Session
    from scan3d_twin.core.types import Plan, Pose2
    from scan3d_twin.recording.views import view_bytes
    from scan3d_twin.run.report import Effort, Journey, build_report, report_json
    from scan3d_twin.run.settings import Settings, settings_toml

    # A session of three views, and a view
    hint = np.array([[0.62, y] for y in np.linspace(-1.1, 1.1, 23)])
    session, rng = (
        Session(Config.preset("paper"), 7, hint, np.array([-1.0, 0.0])),
        np.random.default_rng(0),
    )
    for y in (0.2, 0.0, -0.2):
        seen = synthetic.observe(Pose2(-0.4, y, 0.0), sigma=0.005, rng=rng)
        session = integrate(session, seen)
        session = session.with_plan(Plan(Pose2(-0.4, y, 0.0), 0.8, 0.01, False, (), "a plan"))
    record(folder, session.with_stop_reason("enough"))
    one = replace(session, views=session.views[:1], plans=session.plans[:1])
    record(folder / "one", one.with_stop_reason("enough"))
    (folder / "view.npz").write_bytes(view_bytes(session.views[0]))

    # Options, an experiment, and records
    (folder / "config.toml").write_text(settings_toml(Settings()), encoding="utf-8")
    from scan3d_twin.bench.spec import SUITES

    (folder / "spec.toml").write_text((SUITES / "smoke.toml").read_text(encoding="utf-8"))
    rows = [_record(seed) for seed in range(4)]
    (folder / "journal.jsonl").write_text("\n".join(map(_to_json, rows)) + "\n")
    write_parquet(rows, folder / "results.parquet")

    # A report
    settings = Settings(config=session.config)
    report = build_report(
        "boxes", settings, session, Journey(3.0, 2.0, 90.0), Effort(9.0, 1.0, 1e8), 9
    )
    (folder / "report.json").write_text(report_json(report), encoding="utf-8")

    # A scene and meshes
    import trimesh

    solid = trimesh.util.concatenate(
        [trimesh.creation.icosphere(2, 0.3), trimesh.creation.box((0.4, 0.3, 0.9))]
    )
    for suffix in ("stl", "ply", "obj", "glb"):
        solid.export(folder / f"mesh.{suffix}")
    (folder / "scene.xml").write_text(SCENE)
    return folder


SCENE = """<mujoco model="small">
  <compiler angle="degree"/>
  <option timestep="0.002" gravity="0 0 -9.81"/>
  <asset><material name="m" rgba="0.8 0.7 0.6 1"/>
    <mesh name="wedge" vertex="0 0 0  0.3 0 0  0 0.3 0  0 0 0.3"/></asset>
  <worldbody>
    <light pos="0 0 3" dir="0.3 0 -1"/>
    <site name="spawn" pos="0 0 0" euler="0 0 0"/>
    <geom name="wall" type="box" pos="3 0 0.5" size="0.05 2 0.5"/>
    <body name="target_box" pos="1.5 0.2 0.3" euler="0 0 20">
      <geom type="box" size="0.2 0.3 0.3" material="m"/>
      <geom type="cylinder" size="0.1 0.2" pos="0.3 0 0"/>
    </body>
    <body name="target_wedge" pos="1.6 -0.6 0"><geom type="mesh" mesh="wedge"/></body>
    <replicate count="3" offset="0 0.2 0">
      <geom type="sphere" size="0.05" pos="2.5 -1 0.1"/></replicate>
  </worldbody>
  <custom><numeric name="scan3d.standoff" data="0.8"/>
    <text name="scan3d.tour" data="full"/></custom>
</mujoco>
"""


def _record(seed: int) -> Any:
    from short_experiments import quick_tasks

    from scan3d_twin.bench.record import Step

    step = {"x": 0.1, "y": 0.2, "yaw": 0.3, "path": 1.0, "turn": 1.0, "time": 10.0}
    steps = tuple(
        Step(view=k, coverage=0.3 * (k + 1), error=0.004, predicted=0.005, overlap=0.6, **step)
        for k in range(3)
    )
    blank = quick_tasks(1)[0].blank_record()
    stated = {
        "status": "done",
        "stop": "front complete",
        "complete": True,
        "views": 3,
        "success": True,
    }
    return replace(
        blank, key=f"k{seed}", seed=seed, max_error=0.004, coverage=0.9, steps=steps, **stated
    )


def _to_json(record: Any) -> str:
    from scan3d_twin.bench.record import to_json

    return to_json(record)


def change_bytes(data: bytes, draw: Random) -> bytes:
    """Return ``data`` with a few bytes flipped, cut, doubled or replaced."""
    changed = bytearray(data)
    for _ in range(draw.choice((1, 1, 2, 5, 20))):
        place, length = draw.randrange(len(changed) or 1), draw.choice((1, 2, 4, 8, 64))
        how = draw.randrange(6)
        if how == 0 and changed:
            changed[place % len(changed)] ^= 1 << draw.randrange(8)
        elif how == 1:
            del changed[place : place + length]
        elif how == 2:
            changed[place:place] = changed[place : place + length]
        elif how == 3:
            changed[place : place + length] = draw.randbytes(length)
        elif how == 4:
            changed[place : place + length] = draw.choice((b"\0", b"\xff", b"\x7f")) * length
        else:
            changed[place : place + 4] = struct.pack(
                "<I", draw.choice((0, 1, 2**31 - 1, 2**32 - 1, 2**24))
            )
    return bytes(
        changed[: draw.randrange(len(changed))] if draw.random() < 0.1 and changed else changed
    )


_TOKEN = re.compile(r"-?\d+(?:\.\d+)?(?:[eE][-+]?\d+)?|[A-Za-z_][\w.]*|\"[^\"\n]*\"|[\[\]{}<>=/,]")


_XML = re.compile(r"-?\d+(?:\.\d+)?|(?<=\")[A-Za-z_][^\"]*(?=\")|<[^<>]*>")
"""Numbers, attributes and elements of a scene, so that a change leaves most of it well-formed."""


def change_text(text: str, draw: Random, token: re.Pattern[str] = _TOKEN) -> str:
    """Return ``text`` with a few of its numbers and words replaced, doubled or left out."""
    for _ in range(draw.choice((1, 1, 1, 2, 4))):
        tokens = list(token.finditer(text))
        if not tokens:
            return text
        chosen = draw.choice(tokens)
        how, old = draw.randrange(6), chosen[0]
        new = (
            draw.choice(NUMBERS) if how < 3
            else "" if how == 3
            else old + draw.choice((" ", "", ".")) + old if how == 4
            else draw.choice(tokens)[0]
        )  # fmt: skip
        text = text[: chosen.start()] + new + text[chosen.end() :]
    if draw.random() < 0.05:
        mark = draw.choice(("[", "{", '{"a":', "a.", "\n[a.b]", "<body>", '"'))
        place = draw.randrange(len(text) + 1)
        text = text[:place] + mark * draw.choice((10, 1000, 5000)) + text[place:]
    return text


def _text(source: str, name: str) -> Callable[[Path, Random, Path], Path]:
    """Return how a text file is changed: mostly by words, else by bytes."""

    def make(base: Path, draw: Random, folder: Path) -> Path:
        data = (base / source).read_bytes()
        if draw.random() < 0.7:
            token = _XML if name.endswith(".xml") else _TOKEN
            data = change_text(data.decode("utf-8", "replace"), draw, token).encode()
        else:
            data = change_bytes(data, draw)
        (folder / name).write_bytes(data)
        return folder / name

    return make


def _binary(source: str) -> Callable[[Path, Random, Path], Path]:
    def make(base: Path, draw: Random, folder: Path) -> Path:
        (folder / source).write_bytes(change_bytes((base / source).read_bytes(), draw))
        return folder / source

    return make


def make_glb(base: Path, draw: Random, folder: Path) -> Path:
    """Change the JSON of a .glb, with right lengths, or its bytes."""
    if draw.random() < 0.3:
        return _binary("mesh.glb")(base, draw, folder)
    data = (base / "mesh.glb").read_bytes()
    (length,) = struct.unpack_from("<I", data, 12)
    text = change_text(data[20 : 20 + length].decode(), draw).encode()
    text += b" " * (-len(text) % 4)
    rest = data[20 + length :]
    head = struct.pack("<4sII", b"glTF", 2, 20 + len(text) + len(rest))
    path = folder / "mesh.glb"
    path.write_bytes(head + struct.pack("<I4s", len(text), b"JSON") + text + rest)
    return path


def make_npz(base: Path, draw: Random, folder: Path) -> Path:
    """Change the arrays of a view, written anew, or the bytes of the file."""
    if draw.random() < 0.3:
        return _binary("view.npz")(base, draw, folder)
    with np.load(base / "view.npz") as arrays:
        found = dict(arrays)
    for _ in range(draw.choice((1, 1, 2))):
        name = draw.choice(sorted(found))
        found[name] = _changed_array(found[name], draw)
    if draw.random() < 0.1:
        del found[draw.choice(sorted(found))]
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, array in found.items():
            with archive.open(f"{name}.npy", "w") as file:
                np.lib.format.write_array(file, array)
    (folder / "view.npz").write_bytes(buffer.getvalue())
    return folder / "view.npz"


def _changed_array(array: Any, draw: Random) -> Any:
    how = draw.randrange(8)
    if how == 0:
        return array[: draw.randrange(len(array) + 1)]
    if how == 1:
        return array.astype(draw.choice(("f4", "i2", "u1", "c16", "U8", "f8", "?")))
    if how == 2:
        return array.reshape(-1)[: draw.choice((0, 1, 7))]
    if how == 3:
        return array[..., None]
    if how == 4:
        return array.T
    if how == 5:
        return np.array([{"a": 1}], dtype=object)
    changed = array.astype(np.float64) if how == 6 else array.copy()
    if changed.size:
        special = (
            (np.nan, np.inf, -1e300, 1e12) if changed.dtype.kind == "f" else (-1, 2**14, -(2**14))
        )
        changed.reshape(-1)[draw.randrange(changed.size)] = draw.choice(special)
    return changed


def make_mcap(base: Path, draw: Random, folder: Path) -> Path:
    """Change what a session file holds, written anew with right checksums, or its bytes."""
    from scan3d_twin.recording.mcap.file import McapFile
    from scan3d_twin.recording.mcap.recovering_reader import read_contents
    from scan3d_twin.recording.mcap.rewrite import copy_record

    path = folder / "session.mcap"
    if draw.random() < 0.15:
        path.write_bytes(change_bytes((base / "one/session.mcap").read_bytes(), draw))
        return path
    content = list(read_contents(base / "one/session.mcap"))
    records = [
        k for k, each in enumerate(content) if getattr(each, "topic", "") == "/scan3d_twin/record"
    ]
    for _ in range(draw.choice((1, 1, 2))):
        k = draw.choice(records) if draw.random() < 0.7 else draw.randrange(len(content))
        content[k] = _changed_record(content[k], draw)
    if draw.random() < 0.1:
        del content[draw.randrange(len(content))]
    if draw.random() < 0.05:
        draw.shuffle(content)
    file = McapFile(path, lambda: 0.0)
    for each in content:
        copy_record(each, file)
    file.finish()
    return path


def _changed_record(each: Any, draw: Random) -> Any:
    """Return a metadata record or message with other content; of a session record, other JSON."""
    from mcap.records import Metadata

    from scan3d_twin.recording.mcap import cdr
    from scan3d_twin.recording.mcap import ros_messages as ros

    if isinstance(each, Metadata):
        texts = {name: change_text(text, draw) for name, text in each.metadata.items()}
        return Metadata(each.name, texts)
    if each.topic != "/scan3d_twin/record" or draw.random() < 0.2:
        if draw.random() < 0.3:
            return replace(each, name=draw.choice(("std_msgs/msg/String", "nav_msgs/msg/Path")))
        return replace(each, data=change_bytes(each.data, draw))
    try:
        message = ros.typestore().deserialize_cdr(each.data, each.name)
    except Exception:  # noqa: BLE001 - rosbags compiles its decoders: changed a second time
        return replace(each, data=change_bytes(each.data, draw))
    text, blob = message.json, message.data.tobytes()
    if draw.random() < 0.8:
        text = change_text(text, draw)
    else:
        blob = change_bytes(blob, draw) if blob else blob
    kind = draw.choice(("views", "plans", "mark", "x")) if draw.random() < 0.05 else message.kind
    index = draw.choice((0, 1, 7, 2**31)) if draw.random() < 0.05 else message.index
    _, data = cdr.encode_record(each.nanoseconds / 1e9, kind, index, (text, blob))
    return replace(each, data=data)


def make_fault(base: Path, draw: Random, folder: Path) -> Path:
    """Put a single fault into a session of three views: a bit, a cut or two chunks swapped."""
    from mcap.reader import make_reader

    data = (base / "session.mcap").read_bytes()
    how = draw.choice(("bit", "cut", "swap"))
    if how == "bit":
        changed = bytearray(data)
        changed[draw.randrange(8, len(data))] ^= 1 << draw.randrange(8)
        data = bytes(changed)
    elif how == "cut":
        data = data[: draw.randrange(8, len(data))]
    else:
        index = make_reader(io.BytesIO(data)).get_summary().chunk_indexes  # type: ignore[union-attr]
        (a, b), (c, d) = sorted(
            (i.chunk_start_offset, i.chunk_start_offset + i.chunk_length + i.message_index_length)
            for i in draw.sample(index, 2)
        )
        data = data[:a] + data[c:d] + data[b:c] + data[a:b] + data[d:]
    (folder / "session.mcap").write_bytes(data)
    return folder / "session.mcap"


def read_fault(path: Path) -> None:
    """Repair a session; fewer views than before, or more than one view lost, is an error."""
    from scan3d_twin.core.errors import FileError
    from scan3d_twin.recording.load import load_session
    from scan3d_twin.recording.repair.recover import recover_session

    def count() -> int:
        try:
            return len(load_session(path.parent).session.views)
        except FileError:
            return 0

    size, before = path.stat().st_size, count()
    found = recover_session(path.parent, lambda: 0.0)
    after = count()
    assert after == found.after >= before, (before, found)
    assert size < FULL_SIZE_AT_LEAST or after >= 2, (before, found)


FULL_SIZE_AT_LEAST = 6_000_000
"""Size from which the file of three views is not cut [bytes]."""


def read_session(path: Path) -> None:
    """Read all that a session holds, write its model and a bag; repair what cannot be read."""
    from scan3d_twin.core.errors import FileError
    from scan3d_twin.core.model.fused_cloud import build_model
    from scan3d_twin.recording.export.rosbag2 import ROSBAG2
    from scan3d_twin.recording.load import (
        load_session,
        read_commands,
        read_journey,
        read_last_odometry,
        read_lines,
        read_track,
    )
    from scan3d_twin.recording.repair.recover import recover_session
    from scan3d_twin.viz.timeline import Timeline

    try:
        recorded = load_session(path)
        list(read_lines(path)), list(read_commands(path)), read_last_odometry(path)
        read_journey(recorded), Timeline.of(recorded.session, read_track(path))
        build_model(recorded.session)
        ROSBAG2.write(path, path.with_name("bag"))
    except FileError:
        recover_session(path, lambda: 0.0)
        raise


def read_options(path: Path) -> None:
    """Read options."""
    from scan3d_twin.run.settings import build_settings, read_settings

    build_settings([read_settings(path)])


def read_spec(path: Path) -> None:
    """Read an experiment and make its first tasks."""
    from scan3d_twin.bench.spec import read_experiment

    read_experiment(path)


def read_view(path: Path) -> None:
    """Read a sweep and compute its points."""
    from scan3d_twin.recording.scans import read_image

    assert np.isfinite(read_image(path).points).any()


def read_records(path: Path) -> None:
    """Read results and write their report."""
    from scan3d_twin.bench.reporting.files import write_report
    from scan3d_twin.bench.store import read_results

    place = path.parent if path.suffix == ".jsonl" else path
    write_report(read_results(place), "fuzz", path.parent, path.parent / "report")


def read_report(path: Path) -> None:
    """List a run by its report, and show its errors and its results."""
    from scan3d_twin.cli.commands.runs import runs
    from scan3d_twin.run.report_reader import read_report

    print(sorted(read_report(path).items()))
    runs(path.parent)
    runs(path.parent, json=True)


def read_scene(path: Path) -> None:
    """Load a scene and open the twin in it."""
    from scan3d_twin.sim.robot import open_sim
    from scan3d_twin.sim.scenes.load import load_scene

    with open_sim(load_scene(str(path)), 0):
        pass


def make_journal(base: Path, draw: Random, folder: Path) -> Path:
    """Change one record of a journal as JSON."""
    rows = (base / "journal.jsonl").read_text().splitlines()
    k = draw.randrange(len(rows))
    rows[k] = change_json(rows[k], "steps", draw)
    (folder / "journal.jsonl").write_text("\n".join(rows) + "\n")
    return folder / "journal.jsonl"


def make_report(base: Path, draw: Random, folder: Path) -> Path:
    """Change a report as JSON."""
    text = (base / "report.json").read_text()
    (folder / "report.json").write_text(change_json(text, "registration", draw))
    return folder / "report.json"


ODD_VALUES = (
    None, 0, -1, 1.5, 2.0, True, "text", [], {}, 10**30, 10**400, [[]], -1e300, 1e300, 2**62, "",
    "\ud800", "\x1b[2J", [None], {"": None},
)  # fmt: skip
"""Values that stand where another is wanted; one is no text that UTF-8 can hold."""


def change_json(text: str, rows: str, draw: Random) -> str:
    """Return the object ``text`` with a value changed: its own, or one of its list ``rows``."""
    content = json.loads(text)
    place = draw.choice((content, draw.choice(content[rows])))
    if draw.random() < 0.4:
        return change_text(text, draw)
    place[draw.choice(sorted(place))] = draw.choice(ODD_VALUES)
    return json.dumps(content)


KINDS = {
    kind.name: kind
    for kind in (
        Kind("mcap", make_mcap, read_session),
        Kind("toml", _text("config.toml", "config.toml"), read_options),
        Kind("spec", _text("spec.toml", "spec.toml"), read_spec),
        Kind("npz", make_npz, read_view),
        Kind("journal", make_journal, read_records),
        Kind("report", make_report, read_report),
        Kind("parquet", _binary("results.parquet"), read_records),
        Kind("scene", _text("scene.xml", "scene.xml"), read_scene),
        Kind("stl", _binary("mesh.stl"), read_scene),
        Kind("ply", _binary("mesh.ply"), read_scene),
        Kind("obj", _text("mesh.obj", "mesh.obj"), read_scene),
        Kind("glb", make_glb, read_scene),
        Kind("recover", make_fault, read_fault),
    )
}
