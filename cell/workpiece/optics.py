"""How a surface reflects the projector's light; this decides where an optical sensor measures nothing."""

from __future__ import annotations

from typing import Any

from pydantic import Field, model_validator
from pydantic_core import PydanticCustomError

from pickproof.cell.config import Config

MATERIALS = {
    "matt_grey": (0.5, 0.0, 0.3),
    "black_plastic": (0.04, 0.02, 0.3),
    "cast_aluminium": (0.4, 0.3, 0.4),
    "machined_steel": (0.15, 0.4, 0.25),
    "polished_steel": (0.03, 0.6, 0.08),
}
"""Albedo, specular reflectance and roughness (docs/reference/workpiece-file.md says what is assumed)."""


class Optics(Config):
    """Reflection of a surface: a Lambertian part and a specular lobe. In YAML: a name of MATERIALS, or the numbers."""

    albedo: float = Field(0.5, ge=0, le=1, description="diffuse reflectance")
    specular: float = Field(0.0, ge=0, le=1, description="reflectance of the specular lobe")
    roughness: float = Field(0.3, ge=0.02, le=1, description="root mean square slope of the microfacets (Beckmann)")

    @model_validator(mode="before")
    @classmethod
    def _by_name(cls, data: Any) -> Any:
        if not isinstance(data, str):
            return data
        if data not in MATERIALS:
            raise PydanticCustomError("material", f"one of: {', '.join(MATERIALS)}; or albedo, specular, roughness")
        return dict(zip(("albedo", "specular", "roughness"), MATERIALS[data], strict=True))

    @classmethod
    def of(cls, material: str) -> Optics:
        """The optics of a material of the table."""
        return cls.model_validate(material)
