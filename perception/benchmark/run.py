"""PS6D, its peers and its ablations on the same held-out heaps (Tables I and II)."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

from pickproof.cell.errors import InputError
from pickproof.cell.sensing.sensor_model import SensorConfig
from pickproof.cell.workpiece.workpiece import Workpiece, list_workpieces, load_workpiece
from pickproof.perception.benchmark.frames import STAGE_PARTS, Job, Row, measure_rows, measure_stages
from pickproof.perception.benchmark.methods import METHODS, Method, methods_of
from pickproof.perception.benchmark.tables import markdown, mean_rows, missing_lines
from pickproof.perception.data.scenes import HEAPS_FOLDER, HELD_OUT_SEED, load_heaps
from pickproof.perception.evaluation.heap_frames import Setup
from pickproof.perception.ps6d.weights import file_hash, weights_record
from pickproof.perception.refinement.score_model import score_path

FILE = "benchmark.json"
NOTHING: dict[str, Any] = {"workpieces": {}, "ablations": {}}
"""What benchmark.json holds before any run."""


@dataclass(frozen=True)
class Plan:
    """What is to be measured on one workpiece.

    Attributes:
        methods: those whose weights are there; missing: the others.
        asked: rows that the command asks for.
    """

    workpiece: Workpiece
    methods: list[Method]
    missing: list[Method]
    asked: set[Row]


@dataclass
class Results:
    """benchmark.json: what is known so far, by workpiece and row, each row under the hash of its settings."""

    path: Path
    head: dict[str, Any]
    rows: dict[str, dict[Row, dict[str, Any]]] = field(default_factory=dict)
    weights: dict[str, dict[str, Any]] = field(default_factory=dict)
    stages: dict[str, Any] = field(default_factory=dict)

    def data(self) -> dict[str, Any]:
        """As it is written."""

        def table(name: str) -> dict[str, dict[str, Any]]:
            found = {w: {row: f for (t, row), f in rows.items() if t == name} for w, rows in self.rows.items()}
            return {w: of_one for w, of_one in found.items() if of_one}

        methods = table("methods")
        workpieces = {w: {"methods": methods.get(w, {}), "weights": self.weights[w]} for w in self.rows}
        measured = {"workpieces": workpieces, "ablations": table("ablations"), "stages": self.stages}
        return self.head | measured | {"mean": mean_rows(methods)}

    def save(self) -> None:
        """Write benchmark.json and benchmark.md."""
        self.path.parent.mkdir(parents=True, exist_ok=True)
        part = self.path.with_suffix(".part")
        part.write_text(json.dumps(self.data(), indent=1) + "\n", encoding="utf-8")
        part.replace(self.path)
        self.path.with_suffix(".md").write_text(markdown(self.data()), encoding="utf-8")


@dataclass(frozen=True)
class BenchmarkRequest:
    """What is measured.

    Attributes:
        workpieces: names, none for all.
        frames: held-out heaps of each workpiece; ppf_frames: fewer of them for PPF.
        methods: rows of Table I; ablations: Table II too; stages: time each stage of perception.
        weights_folder: DIR/NAME/ps6d.safetensors in place of the shipped weights.
        variants_folder: DIR/NAME/VARIANT.safetensors in place of the shipped peers and ablations.
        workers: processes of one thread.
        out: folder of benchmark.json and benchmark.md; resume: keep what it holds of the same settings.
        command: the command line, for the record.
    """

    workpieces: tuple[str, ...] = ()
    frames: int = 50
    ppf_frames: int | None = None
    methods: tuple[str, ...] = METHODS
    ablations: bool = False
    stages: bool = False
    weights_folder: Path | None = None
    variants_folder: Path | None = None
    workers: int = 1
    out: Path = Path("out") / "benchmark"
    resume: bool = False
    command: str = ""

    def check(self) -> None:
        """Raise an InputError where options do not fit together, or folders are missing."""
        if self.ppf_frames is not None and self.ppf_frames > self.frames:
            valid = f"at most --frames, which is {self.frames}"
            raise InputError("command line", "--ppf-frames", self.ppf_frames, valid)
        if self.out.exists() and not self.out.is_dir():
            raise InputError("command line", "--out", str(self.out), "a folder; this is a file")
        for option, folder in (("weights-folder", self.weights_folder), ("variants-folder", self.variants_folder)):
            if folder is not None and not folder.is_dir():
                raise InputError("command line", f"--{option}", str(folder), "a folder that exists")


def run_benchmark(asked: BenchmarkRequest, console: Console) -> Results:
    """Measure what is asked for and not known, and write it; `console` shows what is missing and the progress.

    What was finished before an interrupt is kept.

    Raises:
        InputError: no such workpiece or weights.
    """
    asked.check()
    sensor = SensorConfig()
    path = asked.out / FILE
    earlier = _earlier(path) if asked.resume else NOTHING
    names = list(dict.fromkeys([*(asked.workpieces or list_workpieces()), *earlier["workpieces"]]))
    plans = [_plan(asked, load_workpiece(name)) for name in names]
    missing = [entry for plan in plans for entry in _missing(plan)]
    results = Results(
        path,
        {
            "command": asked.command,
            "noise": sensor.enabled,
            "sensor": sensor.model_dump(),
            "missing": missing,
        },
    )
    for plan in plans:
        known = _known(earlier, plan, sensor)
        results.rows[plan.workpiece.name] = known
        shown = [m for m in plan.methods if _rows(m) & (plan.asked | known.keys())]
        results.weights[plan.workpiece.name] = _weights_of(shown)
    for line in missing_lines(results.head):
        console.print(line, soft_wrap=True, highlight=False)
    if missing and not any(_rows(method) & plan.asked for plan in plans for method in plan.methods):
        raise InputError(missing[0]["file"], "", "missing file", f"weights written by `{missing[0]['command']}`")
    results.save()
    with Progress(
        TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn(), console=console
    ) as bar:
        for plan in plans:
            _measure(plan, asked, sensor, results, bar)
        for plan in plans if asked.stages else ():
            _time_stages(plan, asked, sensor, results, bar)
    return results


def _plan(request: BenchmarkRequest, workpiece: Workpiece) -> Plan:
    ppf_frames = request.frames if request.ppf_frames is None else request.ppf_frames
    methods = methods_of(workpiece, request.frames, ppf_frames, request.weights_folder, request.variants_folder)
    asked: set[Row] = {("methods", name) for name in request.methods}
    if request.ablations:
        asked |= {(m.table, row) for m in methods if m.table == "ablations" for row in m.rows}
    there = [m for m in methods if m.weights is None or m.weights.is_file()]
    wanted = [m for m in methods if m not in there and asked & _rows(m)]
    for method in there:
        if asked & _rows(method):
            method.check(workpiece)
    return Plan(workpiece, there, wanted, asked)


def _rows(method: Method) -> set[Row]:
    return {(method.table, row) for row in method.rows}


def _missing(plan: Plan) -> list[dict[str, Any]]:
    """Each file of weights that is not there, the rows that need it, and the command that trains it."""
    entries: dict[str, dict[str, Any]] = {}
    for method in plan.missing:
        name = plan.workpiece.name
        folder = name if method.variant in (None, "ps6d") else f"{name}-{method.variant}"
        entry = {
            "workpiece": name,
            "file": str(method.weights),
            "command": method.train_command(plan.workpiece),
            "trained": str(Path("out") / "train" / folder / "ps6d.safetensors"),
            "rows": [],
        }
        entries.setdefault(str(method.weights), entry)["rows"] += method.rows
    return list(entries.values())


def _weights_of(methods: Sequence[Method]) -> dict[str, Any]:
    """Hash and record of the weights by variant, `shipped` for those that a workpiece comes with."""
    files = {m.variant or "shipped": m.weights for m in methods if m.weights is not None}
    return {name: {"hash": file_hash(file), "record": weights_record(file)} for name, file in files.items()}


def _settings(method: Method, workpiece: Workpiece, sensor: SensorConfig) -> str:
    """First 16 hex digits of the SHA-256 of all that a method's figures depend on, but for the program itself."""
    score = score_path(workpiece)
    parts = {
        "kind": method.kind,
        "frames": method.frames,
        "two_stage": method.two_stage,
        "seed": HELD_OUT_SEED,
        "sensor": sensor.model_dump(),
        "weights": None if method.weights is None else file_hash(method.weights),
        "score": file_hash(score) if method.calibrated and score.is_file() else None,
        "workpiece": file_hash(workpiece.folder / "workpiece.yaml"),
    }
    return hashlib.sha256(json.dumps(parts, sort_keys=True).encode()).hexdigest()[:16]


def _earlier(path: Path) -> dict[str, Any]:
    """An earlier benchmark.json; nothing where there is none."""
    if not path.is_file():
        return NOTHING
    try:
        data = json.loads(path.read_text(encoding="utf-8"))
    except ValueError:
        data = None
    if not isinstance(data, dict) or not all(isinstance(data.get(table), dict) for table in NOTHING):
        raise InputError(path, "", "a damaged file", "a file of `pickproof benchmark`; delete it to start anew")
    return data


def _known(earlier: dict[str, Any], plan: Plan, sensor: SensorConfig) -> dict[Row, dict[str, Any]]:
    """Rows of an earlier run that were measured with the same settings."""
    name = plan.workpiece.name
    known: dict[Row, dict[str, Any]] = {}
    for method in plan.methods:
        before = earlier["workpieces"].get(name, {}).get("methods", {})
        if method.table == "ablations":
            before = earlier["ablations"].get(name, {})
        settings = _settings(method, plan.workpiece, sensor)
        for row in method.rows:
            if before.get(row, {}).get("settings") == settings:
                known[method.table, row] = before[row]
    return known


def _measure(plan: Plan, asked: BenchmarkRequest, sensor: SensorConfig, results: Results, bar: Progress) -> None:
    """Measure the rows that are asked for and not known, and write."""
    workpiece, known = plan.workpiece, results.rows[plan.workpiece.name]
    due = [m for m in plan.methods if _rows(m) & plan.asked - known.keys()]
    if not due:
        return
    count = max(m.frames for m in due)
    settling = bar.add_task(f"{workpiece.name}: settling heaps", total=count)
    heaps = load_heaps(
        workpiece, HELD_OUT_SEED, count, HEAPS_FOLDER, asked.workers, lambda n: bar.update(settling, completed=n)
    )
    seeing = bar.add_task(f"{workpiece.name}: measuring", total=count)
    job = Job(workpiece.name, tuple(due), sensor)
    measured = measure_rows(job, heaps, asked.workers, lambda: bar.advance(seeing))
    for method in plan.methods:
        settings = _settings(method, workpiece, sensor)
        for row in _rows(method) & measured.keys() & plan.asked:
            known[row] = measured[row] | {"settings": settings}
    order = [(m.table, row) for m in plan.methods for row in m.rows]
    results.rows[workpiece.name] = {row: known[row] for row in order if row in known}
    results.save()


def _time_stages(plan: Plan, asked: BenchmarkRequest, sensor: SensorConfig, results: Results, bar: Progress) -> None:
    workpiece = plan.workpiece
    shipped = next((m for m in plan.methods if m.table == "methods" and m.calibrated and m.kind == "ps6d"), None)
    if shipped is None:
        bar.console.print(f"{workpiece.name}: no stages: no weights")
        return
    heaps = load_heaps(workpiece, HELD_OUT_SEED, asked.frames, HEAPS_FOLDER, asked.workers)
    timing = bar.add_task(f"{workpiece.name}: stages", total=1)
    found = measure_stages(Setup(workpiece.name, shipped.weights, sensor, HELD_OUT_SEED), heaps)
    bar.advance(timing)
    if found is None:
        low, high = STAGE_PARTS
        bar.console.print(f"{workpiece.name}: no stages: none of {len(heaps)} heaps holds {low} to {high} parts")
        return
    results.stages[workpiece.name] = found
    results.save()
