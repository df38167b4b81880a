"""Training clouds, streamed: a stored heap, a random view, fresh noise; or an image of a dataset; fresh sampling.

Cloud i of a stream depends on (seed, i) alone, and clouds are handed on in the order of i whatever the number of
loader processes, so a training run is reproducible.
"""

from __future__ import annotations

import multiprocessing as mp
import os
from collections.abc import Generator
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch

from pickproof.cell.frames import Array, invert
from pickproof.cell.sensing.sensor_model import measure
from pickproof.cell.workpiece.workpiece import Workpiece, load_workpiece
from pickproof.perception.data.bop_read import BopImage
from pickproof.perception.data.scenes import View, heap_bin, random_view, render_heap
from pickproof.perception.ps6d.cloud import Cloud, roi_mask, scene_cloud
from pickproof.perception.ps6d.loss import Target, centre_distance_weights
from pickproof.perception.ps6d.point_hierarchy import Graph, build_graph, top_neighbours

Samples = Generator["Sample", None, None]
Scene = Array | BopImage
"""What a cloud is made of: the poses Ts_world_part (n, 4, 4) of a settled heap, or an image of a dataset."""


@dataclass(frozen=True)
class Sample:
    """A graph and the truth of its voting points.

    Attributes:
        graph: see sampling.Graph.
        keep: (m,) bool: the voting point lies on a workpiece (edge pixels may show the bin).
        instance: (m,) index of the workpiece, -1 where not kept.
        centres: (m, 3) in units, in the cloud's space; rotations: (m, 3, 3).
    """

    graph: Graph
    keep: np.ndarray
    instance: np.ndarray
    centres: np.ndarray
    rotations: np.ndarray


def label(graph: Graph, cloud: Cloud, ids: np.ndarray, Ts_camera_part: Array) -> Sample:
    """Attach the truth to a graph; `ids` (h, w) are the instance ids of the exact render."""
    pixels = cloud.pixels[graph.source]
    instance = ids[pixels[:, 0], pixels[:, 1]]
    centres = ((Ts_camera_part[:, :3, 3] - cloud.origin) / cloud.unit)[instance]
    return Sample(
        graph,
        instance >= 0,
        instance,
        centres.astype(np.float32),
        Ts_camera_part[instance, :3, :3].astype(np.float32),
    )


def make_sample(workpiece: Workpiece, poses: Array, view: View, rng: np.random.Generator) -> Sample | None:
    """One labelled cloud of a heap; None when next to nothing is seen."""
    exact = render_heap(workpiece, poses, view)
    frame = measure(exact, view.intrinsics, view.T_world_camera, view.sensor, rng, workpiece.optics)
    cloud = scene_cloud(frame, roi_mask(frame, heap_bin(workpiece)), workpiece.unit)
    graph = build_graph(cloud, rng, top_neighbours(workpiece))
    if graph is None:
        return None
    return label(graph, cloud, exact.ids, invert(view.T_world_camera) @ poses)


def image_sample(workpiece: Workpiece, image: BopImage, rng: np.random.Generator) -> Sample | None:
    """One labelled cloud of an image; None when next to nothing is seen."""
    frame = image.frame()
    cloud = scene_cloud(frame, image.region(frame, workpiece), workpiece.unit)
    graph = build_graph(cloud, rng, top_neighbours(workpiece))
    if graph is None:
        return None
    return label(graph, cloud, image.ids(frame, workpiece), image.Ts_camera_part)


def train_sample(workpiece: Workpiece, scenes: list[Scene], seed: int, index: int) -> Sample:
    """Cloud `index` of the stream `seed`."""
    rng = np.random.default_rng((seed, index))
    while True:
        scene = scenes[int(rng.integers(len(scenes)))]
        if isinstance(scene, BopImage):
            sample = image_sample(workpiece, scene, rng)
        else:
            if rng.random() < 0.25:  # sparse heaps, as the paper trains on
                scene = scene[rng.random(len(scene)) < rng.uniform(0.3, 0.9)]
            sample = make_sample(workpiece, scene, random_view(workpiece, rng), rng) if len(scene) else None
        if sample is not None and sample.keep.sum() > 16:
            return sample


def collate(samples: list[Sample], unit_device: torch.device) -> tuple[torch.Tensor, Target]:
    """Indices of the kept voting points in the packed batch, and their targets."""
    keep, instance, points = [], [], []
    start = first = 0
    for s in samples:
        keep.append(np.flatnonzero(s.keep) + start)
        instance.append(s.instance[s.keep] + first)
        points.append(s.graph.levels[0].points[s.keep])
        start += len(s.keep)
        first += int(s.instance.max()) + 1
    p = torch.from_numpy(np.concatenate(points))
    c = torch.from_numpy(np.concatenate([s.centres[s.keep] for s in samples]))
    R = torch.from_numpy(np.concatenate([s.rotations[s.keep] for s in samples]))
    weights = centre_distance_weights(p, c, torch.from_numpy(np.concatenate(instance)).long())
    target = Target(*(x.to(unit_device) for x in (p, c, R, weights)))
    return torch.from_numpy(np.concatenate(keep)).to(unit_device), target


def _work(queue: Any, name: str, scenes: list[Scene], seed: int, start: int, stride: int) -> None:
    os.environ["OMP_NUM_THREADS"] = "1"
    torch.set_num_threads(1)
    workpiece = load_workpiece(name)
    index = start
    while True:
        queue.put(train_sample(workpiece, scenes, seed, index))
        index += stride


def stream(workpiece: Workpiece, scenes: list[Scene], seed: int, start: int, workers: int) -> Samples:
    """Endless clouds start, start + 1, ... of a stream, made by `workers` processes (0: in this one)."""
    if workers == 0:
        index = start
        while True:
            yield train_sample(workpiece, scenes, seed, index)
            index += 1
    context = mp.get_context("spawn")
    queues = [context.Queue(maxsize=4) for _ in range(workers)]
    processes = [
        context.Process(target=_work, args=(q, workpiece.name, scenes, seed, start + i, workers), daemon=True)
        for i, q in enumerate(queues)
    ]
    for process in processes:
        process.start()
    try:
        turn = 0
        while True:
            yield queues[turn % workers].get(timeout=600)
            turn += 1
    finally:
        for process in processes:
            process.terminate()
