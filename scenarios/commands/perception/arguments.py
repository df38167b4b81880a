"""Options that several of the commands of perception share."""

# no `from __future__ import annotations`: cyclopts evaluates a field inherited from here in the module of the heir
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Group
from cyclopts.validators import MutuallyExclusive

from pickproof.cell.errors import InputError
from pickproof.perception.method import Method
from pickproof.scenarios.commands.arguments import about

if TYPE_CHECKING:
    from pickproof.cell.sensing.sensor_model import SensorConfig
    from pickproof.perception.training.scene_source import SceneSource

MethodName = Annotated[
    Method,
    about("ps6d: trained network; search: no training; both; auto: ps6d where weights exist, else search"),
]
_SCENES = Group("own scenes, one of", validator=MutuallyExclusive())
_NOISE = Group("noise of the camera, one of", validator=MutuallyExclusive())


@dataclass(frozen=True, kw_only=True)
class SourceOptions:
    """--data, --bop, --split, --bop-sensor and --obj."""

    data: Annotated[Path | None, about("folder of scenes of `pickproof generate`", group=_SCENES)] = None
    bop: Annotated[Path | None, about("depth images and poses of a BOP dataset", group=_SCENES)] = None
    split: Annotated[str | None, about("split of --bop, as train_pbr; default: the only one")] = None
    bop_sensor: Annotated[str | None, about("sensor of --bop with several, as photoneo")] = None
    obj: Annotated[int | None, about("object of --bop; default: the only one")] = None

    def source(self) -> "SceneSource":
        """The source of scenes in the form that perception takes."""
        from pickproof.perception.training.scene_source import SceneSource

        return SceneSource(self.data, self.bop, self.split, self.bop_sensor, self.obj)


@dataclass(frozen=True, kw_only=True)
class NoiseOptions:
    """--sensor and --no-noise."""

    sensor: Annotated[str | None, about("camera class; default: structured_light", group=_NOISE)] = None
    no_noise: Annotated[bool, about("exact depth in place of the sensor model", group=_NOISE)] = False

    def sensor_config(self) -> "SensorConfig":
        """The sensor's model.

        Raises:
            InputError: no such class of camera.
        """
        from pickproof.cell.sensing.sensor_model import SensorConfig, list_presets

        if self.sensor is None:
            return SensorConfig(enabled=not self.no_noise)
        if self.sensor not in list_presets():
            raise InputError("command line", "--sensor", self.sensor, f"one of: {', '.join(list_presets())}")
        return SensorConfig.of_preset(self.sensor)
