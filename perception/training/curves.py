"""Progress and validation curves of a training run as a picture."""

from __future__ import annotations

from pathlib import Path


def draw_curves(history: list[dict[str, float]], path: Path, title: str) -> None:
    """Errors in units and the share of right voting points against clouds seen."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9, 4), layout="constrained")
    FigureCanvasAgg(figure)
    left, right = figure.subplots(1, 2)
    clouds = [row["clouds"] for row in history]
    for key, label in (
        ("centre", "centre, validation median"),
        ("rotation", "rotation, validation median"),
        ("train_rotation", "rotation, training mean"),
        ("train_translation", "translation, training mean"),
        ("train_cad", "CAD coordinates, training mean"),
    ):
        if key in history[-1]:
            left.plot(clouds, [row.get(key, float("nan")) for row in history], marker=".", label=label)
    left.set(xlabel="clouds seen", ylabel="error [unit]", title=title, ylim=(0, None))
    left.legend(fontsize=7)
    left.grid(alpha=0.3)
    right.plot(clouds, [100 * row["right"] for row in history], marker=".")
    minutes = history[-1]["seconds"] / 60
    right.set(xlabel="clouds seen", ylabel="voting points right [%]", ylim=(0, 100), title=f"{minutes:.0f} min")
    right.grid(alpha=0.3)
    figure.savefig(path, dpi=110)
