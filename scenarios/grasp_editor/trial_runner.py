"""The physics of the grasp editor: trials of grasps in a separate thread, and the film of each trial."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any

import numpy as np

from pickproof.cell.errors import PickproofError
from pickproof.cell.frames import Array
from pickproof.cell.grippers.base import Gripper
from pickproof.cell.workpiece.workpiece import Workpiece
from pickproof.grasping.grasp_points import GraspPoint
from pickproof.scenarios.grasp_editor.film import HeapCell, Outcome, try_free
from pickproof.scenarios.grasp_editor.panel import EVERYWHERE, GREEN, HEAP, HINTS, Panel, resting_name
from pickproof.scenarios.grasp_editor.scene import EditorScene
from pickproof.scenarios.grasp_trials.trial import TrialCell

TICK = 0.04  # [s] between frames of a film
SLOW = 2.0  # slow-motion factor


class GraspTries:
    """Tries grasps one after the other, and shows the films; `close` it after use.

    Args:
        lock: held by whoever writes into page and scene.

    Attributes:
        resting: Ts_world_part (k, 4, 4) in which the workpiece lies, likeliest first; none until they are known.
    """

    def __init__(
        self, workpiece: Workpiece, gripper: Gripper, scene: EditorScene, panel: Panel, lock: threading.RLock
    ) -> None:
        self._workpiece, self._gripper = workpiece, gripper
        self._scene, self._panel, self._lock = scene, panel, lock
        self.resting: Array = np.zeros((0, 4, 4))
        self._trial: TrialCell | None = None
        self._heap: HeapCell | None = None
        self._seed = 0
        self._outcomes: dict[str, Outcome] = {}
        self._shown: Outcome | None = None
        self._playing, self._closed = False, False
        self._physics = ThreadPoolExecutor(1, thread_name_prefix="physics")
        self._submit(self._prepare)
        self._player = threading.Thread(target=self._run_film, daemon=True)
        self._player.start()

    def close(self) -> None:
        """Wait for what is being tried, and end."""
        self._closed = True
        self._player.join()
        self._physics.shutdown(wait=True, cancel_futures=True)
        for cell in (self._trial, self._heap):
            if cell is not None:
                cell.close()

    def begin(self, point: GraspPoint, where: str) -> None:
        """Try a grasp in one place or everywhere; the page shows the result."""
        self._panel.busy(True)
        self._submit(self._try, point, where)

    def another_heap(self) -> None:
        """Fill the heap again."""
        self._seed += 1
        self._submit(self._settle, self._seed)

    def _submit(self, job: Callable[..., None], *words: Any) -> None:
        self._physics.submit(job, *words).add_done_callback(self._ended)

    def _ended(self, job: Future[None]) -> None:
        """Show an unexpected error of the thread on the page."""
        if not job.cancelled() and (error := job.exception()) is not None:
            self._panel.say(f"The physics failed: {type(error).__name__}: {error}")
            self._panel.busy(False)

    def _prepare(self) -> None:
        self._trial = TrialCell(self._workpiece, self._gripper)
        self.resting = self._trial.resting_poses()
        self._settle(self._seed)
        self._panel.list_resting(len(self.resting))

    def _settle(self, seed: int) -> None:
        try:
            heap = HeapCell(self._workpiece, self._gripper, seed)
        except PickproofError as error:
            self._panel.say(f"No heap for trials: {error}")
            return
        if self._heap is not None:
            self._heap.close()
            self._panel.say(f"Heap {seed} has settled: try the grasp in it.", GREEN)
        self._heap = heap

    def _try(self, point: GraspPoint, where: str) -> None:
        begun = time.monotonic()
        outcomes: dict[str, Outcome] = {}
        try:
            for k, T_world_part in enumerate(self.resting):
                if self._trial is not None and where in (EVERYWHERE, resting_name(k)):
                    outcomes[resting_name(k)] = try_free(self._trial, T_world_part, point)
            if self._heap is not None and where in (EVERYWHERE, HEAP):
                outcomes[HEAP] = self._heap.try_grasp(point)
        except PickproofError as error:
            self._panel.say(str(error))
        with self._lock:
            self._outcomes = outcomes
            self._panel.results(outcomes, time.monotonic() - begun)
            held = any(outcome.held for outcome in outcomes.values())
            self._panel.hint.content = HINTS["tried" if held else "lost"]
            films = [name for name, outcome in outcomes.items() if outcome.film is not None]
            if films:
                self.film_of(films[0])
            self._panel.busy(False)

    def stage(self, outcome: Outcome | None) -> None:
        """Show a film, stopped at its start, or None: the workpiece to be edited."""
        with self._lock:
            self._shown, self._playing = outcome, False
            self._scene.show_film(outcome)
            if outcome is not None and outcome.film is not None:
                self._panel.time.max = max(round(float(outcome.film.time[-1]), 2), 0.02)
                self._panel.time.value = 0.0
                self._scene.film_to(outcome, 0)

    def film_of(self, where: str) -> None:
        """Run the film of one place."""
        with self._lock:
            outcome = self._outcomes.get(where)
            if outcome is not None and outcome.film is not None:
                self.stage(outcome)
                self._playing = True

    def film_at(self, seconds: float) -> None:
        """Show the film at a time."""
        with self._lock:
            if self._shown is not None and self._shown.film is not None:
                times = self._shown.film.time
                frame = int(np.clip(np.searchsorted(times, seconds - 1e-3), 0, len(times) - 1))
                self._scene.film_to(self._shown, frame)

    def play(self, on: bool) -> None:
        """Run the film, or stop it; from the start where it has ended."""
        with self._lock:
            if self._shown is not None and on and float(self._panel.time.value) >= float(self._panel.time.max) - 1e-6:
                self._panel.time.value = 0.0
            self._playing = on and self._shown is not None

    def _run_film(self) -> None:
        while not self._closed:
            time.sleep(TICK)
            with self._lock:
                if self._playing:
                    after = min(float(self._panel.time.value) + TICK / SLOW, float(self._panel.time.max))
                    self._panel.time.value = after
                    self._playing = after < float(self._panel.time.max) - 1e-6
