"""What a user chooses about a render."""

from __future__ import annotations

import os
from dataclasses import dataclass, field

from .camera import BOX, FILTERS
from .light_tree.options import TreeOptions
from .light_tree.sample import SAMPLERS, TREE

MIS_HEURISTICS = ("power", "balance")


@dataclass(frozen=True)
class Settings:
    """How to render; a scene says what.

    Parameters
    ----------
    samples : per pixel; with a time limit, at most so many
    time_limit_s : seconds of tracing, 0 for no limit; a pass that would overrun it is not begun
    sampler : how lights are chosen: "tree", "power" (by emitted power) or "uniform"
    split_lights : lights chosen at each surface the camera sees, and at the next one a path meets;
        one at later ones
    tree : how the light tree is built and walked
    max_bounces : of any kind; 0 is direct light only, as in Cycles
    max_passes : transparent surfaces that a ray goes straight through, beside its bounces
    seed : of all random numbers
    threads : 0 for one per core
    mis : heuristic of multiple importance sampling, "power" or "balance"
    roulette_depth : bounces after which paths may end at random
    filter : what a pixel takes of the image around it: "box", "gaussian" or "blackman-harris"
    filter_width_px : a gaussian ends 1.5 widths from the pixel's middle, a Blackman-Harris window
        after one, as in Cycles; a box is the pixel itself
    light_passes : whether the film also tells emission, and direct and indirect diffuse light
    """

    samples: int = 64
    time_limit_s: float = 0.0
    sampler: str = TREE
    split_lights: int = 2
    tree: TreeOptions = field(default_factory=TreeOptions)
    max_bounces: int = 4
    max_passes: int = 8
    seed: int = 0
    threads: int = 0
    mis: str = "power"
    roulette_depth: int = 3
    filter: str = BOX
    filter_width_px: float = 1.5
    light_passes: bool = False

    def check(self) -> None:
        """Raise ValueError, naming the setting, if one makes no sense."""
        for name, least in (
            ("samples", 1),
            ("time_limit_s", 0),
            ("split_lights", 1),
            ("max_bounces", 0),
            ("max_passes", 0),
            ("seed", 0),
            ("threads", 0),
            ("roulette_depth", 0),
        ):
            value = getattr(self, name)
            if not least <= value < 2**31:
                raise ValueError(f"{name} must be between {least} and 2^31, not {value}")
        if not 0 < self.filter_width_px <= 10:
            raise ValueError(f"filter_width_px must be within 0 to 10, not {self.filter_width_px}")
        for name, allowed in (
            ("sampler", SAMPLERS),
            ("mis", MIS_HEURISTICS),
            ("filter", FILTERS),
        ):
            value = getattr(self, name)
            if value not in allowed:
                raise ValueError(f"{name} must be one of {', '.join(allowed)}, not {value!r}")

        self.tree.check()

    @property
    def num_threads(self) -> int:
        """Threads to use on this machine."""
        if self.threads:
            return self.threads
        if hasattr(os, "sched_getaffinity"):
            return len(os.sched_getaffinity(0))
        return os.cpu_count() or 1
