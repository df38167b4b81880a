"""The scenario: one typed schema that is the YAML, the effective configuration and its hash.

Lengths in [m], angles in [rad] unless the name says deg, times in [s], forces in [N].
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Collection, Sequence
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import Field, field_validator, model_validator
from ruamel.yaml.error import YAMLError

from pickproof.cell.config import Angle, Config, Fine, Point, Size, Small, metres, parse, read_yaml, yaml_value
from pickproof.cell.errors import InputError, did_you_mean
from pickproof.cell.frames import Array
from pickproof.cell.geometry.bin import Bin, Box, table
from pickproof.cell.grippers.registry import load_gripper
from pickproof.cell.physics.convergence import FEWEST, MOST, solver_iterations
from pickproof.cell.sensing.camera import Intrinsics, look_at
from pickproof.cell.sensing.sensor_model import SensorConfig
from pickproof.cell.workpiece.workpiece import list_workpieces, load_workpiece, search_path, workpiece_folder
from pickproof.grasping.ranking import GraspingConfig
from pickproof.perception.method import Method
from pickproof.scenarios.config.placing import HeapPlace, PatternPlace, PlaceConfig
from pickproof.scenarios.config.seeds import MAX_SEED

SHIPPED = Path(__file__).resolve().parents[1]
OF_WORKPIECE = "scenario.yaml"
"""File name of the scenario in a workpiece's folder; it has the name of that folder."""
TableEdge = Annotated[float, Field(gt=0), metres(20.0)]


class BinConfig(Config):
    """An open bin; its frame is at the centre of the inner floor."""

    inner: Size = Field(default=(0.26, 0.20, 0.06), description="[m] inner length (x), width (y), depth (z)")
    wall: Fine = Field(default=0.006, gt=0, description="[m] thickness of walls and floor")
    position: Point = Field(description="[m] of the inner floor's centre in the world")
    yaw: Angle = Field(default=0.0, description="[rad] about world z")

    @model_validator(mode="after")
    def _solid(self) -> BinConfig:
        if min(self.inner) <= 0:
            raise ValueError("inner must be three positive lengths in [m]")
        return self

    def build(self, name: str) -> Bin:
        """The bin at its place in the world."""
        return Bin(name, self.inner, self.wall, self.position, self.yaw)


class TableConfig(Config):
    """The table that everything stands on."""

    size: tuple[TableEdge, TableEdge, TableEdge] = Field(default=(1.6, 1.6, 0.05), description="[m] edge lengths")
    centre_top: Point = Field(
        default=(0.2, 0.0, 0.0), description="[m] centre of the top face; the robot stands at z = 0"
    )

    def build(self) -> Box:
        """The table as a box in the world."""
        return table(self.size, self.centre_top)


class CameraConfig(Config):
    """A fixed overhead camera; its image x axis is along world x, its y axis along world -y."""

    width: int = Field(default=640, ge=64, le=1280, description="[pixel]")
    height: int = Field(default=480, ge=64, le=1024, description="[pixel]")
    fov_deg: float = Field(default=21.0, gt=1, lt=120, description="[deg] full horizontal field of view")
    eye: Point = Field(default=(0.45, 0.0, 0.86), description="[m] position in the world")
    target: Point = Field(default=(0.45, 0.0, 0.01), description="[m] point that the optical axis goes through")
    sensing_time_s: float = Field(
        default=0.4, ge=0, le=60, description="[s] duration of a capture, part of the cycle time"
    )

    @model_validator(mode="after")
    def _looks_somewhere(self) -> CameraConfig:
        along = [t - e for e, t in zip(self.eye, self.target, strict=True)]
        if along[0] ** 2 + along[2] ** 2 < 1e-6:
            raise ValueError("eye and target must differ, and not along world y alone")
        return self

    @property
    def intrinsics(self) -> Intrinsics:
        """The pinhole model of the camera."""
        return Intrinsics.from_fov(self.width, self.height, float(np.deg2rad(self.fov_deg)))

    @property
    def T_world_camera(self) -> Array:
        """Pose (4, 4) of the camera, which looks at `target`."""
        return look_at(np.array(self.eye), np.array(self.target))


class PhysicsConfig(Config):
    """Settings of the physics (docs/explanation/physics.md says why these)."""

    timestep: float = Field(default=1 / 480, gt=1e-4, le=1 / 100, description="[s] of one physics step")
    solver_iterations: int = Field(
        default=FEWEST, ge=1, le=MOST, description="where a file does not say: what part and gripper need"
    )


class PerceptionConfig(Config):
    """Method of perception, and which estimates are passed to grasping."""

    method: Method = Field(
        default="auto",
        description="ps6d: trained network; search: no training; both; auto: ps6d where weights exist, else search",
    )
    min_score: float = Field(
        default=0.8, ge=0, le=1, description="calibrated score below which an estimate is rejected"
    )
    max_estimates: int = Field(
        default=30, ge=1, le=200, description="largest number of estimates passed on, best first"
    )


class LimitsConfig(Config):
    """Limits of a successful attempt."""

    contact_force_N: float = Field(
        default=50.0, gt=0, description="[N] largest contact force of arm or gripper, fingers excepted"
    )
    attempt_timeout_s: float = Field(default=30.0, gt=0, le=600, description="[s] simulated time of one attempt")


class StopConfig(Config):
    """When an episode ends before the bin is cleared."""

    failures_in_a_row: int = Field(default=3, ge=1, description="failed attempts that end the episode")
    attempt_limit: int = Field(default=80, ge=1, description="attempts and no-picks that end the episode")
    attempts_to_avoid: int = Field(default=4, ge=0, description="attempts for which a failed workpiece is avoided")


class CarryConfig(Config):
    """Motion of the held workpiece."""

    speed_scale: float = Field(default=0.8, gt=0, le=1, description="of the 15 m/s2 allowed to the held part")
    straight: Small = Field(
        default=0.012, description="[m] of every line that must be straight; the rest may be rounded"
    )
    straight_place: Small = Field(default=0.005, description="the same at a heap's place; a pattern takes `straight`")


def robots() -> list[str]:
    """Names of the shipped robots, without loading the libraries of their folder."""
    return sorted(path.parent.name for path in (SHIPPED.parent / "robots").glob("*/robot.yaml"))


class WristConfig(Config):
    """The force sensor that weighs what was lifted."""

    noise_N: float = Field(default=0.05, ge=0, description="[N] standard deviation of a reading")
    seconds: float = Field(default=0.05, gt=0, le=1, description="[s] the arm stands still for it after the lift")
    double_above: float = Field(
        default=1.7, gt=1, description="number of workpiece weights from which a pick is put back"
    )


class Scenario(Config):
    """A bin-picking cell and its task."""

    name: str = Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_-]*$", description="letters, digits, _ and -")
    workpiece: str = Field(description="a name that `pickproof list` shows")
    count: int = Field(default=30, ge=1, le=500, description="workpieces dropped into the source bin")
    seed: int = Field(
        default=0, ge=0, le=MAX_SEED, description="of the first episode; the next take seed + 1, seed + 2, ..."
    )
    robot: str = Field(default="lrmate200id", description="a folder of robots/")
    gripper: str = Field(default="jaw_v1", description="name of a shipped gripper, or the path of its YAML file")
    grasps: str = Field(
        default="",
        description="file of grasp points in place of the workpiece's grasps.yaml; from this file's folder",
    )
    source_bin: BinConfig = BinConfig(position=(0.45, 0.0, 0.01))
    place_bin: BinConfig = BinConfig(inner=(0.40, 0.30, 0.06), position=(0.16, -0.43, 0.01))
    place: PlaceConfig = Field(default=HeapPlace(), description="kind heap, or pattern with its grid")
    table: TableConfig = TableConfig()
    camera: CameraConfig = CameraConfig()
    sensor: SensorConfig = SensorConfig.model_validate({})
    physics: PhysicsConfig = PhysicsConfig()
    perception: PerceptionConfig = PerceptionConfig()
    grasping: GraspingConfig = GraspingConfig()
    limits: LimitsConfig = LimitsConfig()
    stop: StopConfig = StopConfig()
    carry: CarryConfig = CarryConfig()
    wrist: WristConfig = WristConfig()

    @property
    def straight_place(self) -> float:
        """[m] of the lines at the place that must be straight."""
        return self.carry.straight if isinstance(self.place, PatternPlace) else self.carry.straight_place

    @field_validator("robot")
    @classmethod
    def _known(cls, robot: str) -> str:
        if robot not in robots():
            raise ValueError(f"one of: {', '.join(robots())}")
        return robot


def list_scenarios() -> list[str]:
    """Names of all scenarios: those in the folders of workpieces on the search path, and the shipped ones."""
    own = {path.parent.name for folder in search_path() for path in folder.glob(f"*/{OF_WORKPIECE}")}
    return sorted(own | {path.stem for path in SHIPPED.glob("*.yaml")})


def load_scenario(name_or_path: str, overrides: Sequence[str] = ()) -> Scenario:
    """Load a scenario by its name or from a YAML file.

    Args:
        overrides: `dotted.field=value` each, the value in YAML; they replace what the file says.

    Raises:
        InputError: no such scenario, a field that does not fit the schema, or an unknown workpiece.
    """
    path = scenario_path(name_or_path)
    data = read_yaml(path)
    for override in overrides:
        _apply(data, override)
    file = f"{path} with --set {' '.join(overrides)}" if overrides else str(path)
    scenario = parse(Scenario, data, file)
    if scenario.grasps:
        from_command = any(o.partition("=")[0] == "grasps" for o in overrides)
        table = (Path.cwd() if from_command else path.parent) / scenario.grasps
        scenario = scenario.model_copy(update={"grasps": str(table.resolve())})
    if scenario.workpiece not in list_workpieces():
        known = list_workpieces()
        valid = f"one of: {', '.join(known)}{did_you_mean(scenario.workpiece, known)}"
        raise InputError(file, "workpiece", scenario.workpiece, valid)
    return scenario if "solver_iterations" in scenario.physics.model_fields_set else _converged(scenario)


def _converged(scenario: Scenario) -> Scenario:
    """The scenario with the iterations of the solver that its workpiece and gripper need.

    Where one of their files cannot be read the default stays: `check_inputs` refuses that file before a run.
    """
    try:
        needed = solver_iterations(load_workpiece(scenario.workpiece), load_gripper(scenario.gripper))
    except InputError:
        return scenario
    if needed == scenario.physics.solver_iterations:
        return scenario
    physics = scenario.physics.model_copy(update={"solver_iterations": needed})
    return scenario.model_copy(update={"physics": physics})


def scenario_json(scenario: Scenario) -> str:
    """The effective scenario, defaults filled in, as canonical JSON: sorted keys, no spaces."""
    return json.dumps(scenario.model_dump(mode="json"), sort_keys=True, separators=(",", ":"))


def scenario_hash(scenario: Scenario) -> str:
    """SHA-256 of the canonical JSON without `seed`: identifies the cell and the task."""
    data = json.loads(scenario_json(scenario))
    del data["seed"]
    if data["perception"]["method"] == "auto":  # campaigns older than the field keep their stored hash
        del data["perception"]["method"]
    return hashlib.sha256(json.dumps(data, sort_keys=True, separators=(",", ":")).encode()).hexdigest()


def weights_hash(workpiece: str) -> str:
    """SHA-256 of the weights beside a workpiece (its .safetensors files in order of name); empty without any."""
    folder = workpiece_folder(workpiece)
    files = sorted(folder.glob("*.safetensors")) if folder else []
    if not files:
        return ""
    digest = hashlib.sha256()
    for file in files:
        digest.update(file.read_bytes())
    return digest.hexdigest()


def weights_used(scenario: Scenario, oracle: Collection[str]) -> str:
    """`weights_hash` of a scenario's workpiece; empty where ground truth or the search stands in for the network."""
    no_network = "perception" in oracle or scenario.perception.method == "search"
    return "" if no_network else weights_hash(scenario.workpiece)


def scenario_path(name_or_path: str) -> Path:
    """The file of a scenario, by its name or its path; the existence of a path is not checked.

    Raises:
        InputError: no scenario of that name.
    """
    if name_or_path in list_scenarios():
        own = (root / name_or_path / OF_WORKPIECE for root in search_path())
        return next((path for path in own if path.is_file()), SHIPPED / f"{name_or_path}.yaml")
    path = Path(name_or_path)
    if path.suffix in (".yaml", ".yml"):
        return path  # read_yaml reports a missing file
    known = list_scenarios()
    valid = f"one of: {', '.join(known)}; or the path of a .yaml file{did_you_mean(name_or_path, known)}"
    raise InputError("command line", "SCENARIO", name_or_path, valid)


def _apply(data: dict[str, Any], override: str) -> None:
    field, equals, text = override.partition("=")
    keys = field.split(".")
    if not equals or not all(keys):
        raise InputError("command line", "--set", override, "FIELD=VALUE with a dotted field, as camera.width=1280")
    try:
        value = yaml_value(text)
    except (YAMLError, ValueError, RecursionError):  # as 2001-99-99 for a date; a thousand brackets
        raise InputError("command line", f"--set {field}", text, "a value in YAML") from None
    for key in keys[:-1]:
        data = data.setdefault(key, {})
        if not isinstance(data, dict):
            raise InputError("command line", "--set", override, f"a field; {key} has no fields of its own")
    data[keys[-1]] = value
