"""How a light tree is built, weighed and walked: the choices, their names and their defaults."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

from .nodes import NUM_LANES

SAOH, SAH, MIDDLE, EQUAL = "saoh", "sah", "middle", "equal"
SPLITS = (SAOH, SAH, MIDDLE, EQUAL)
EQUAL_WIDTH, EQUAL_COUNT = "width", "count"
BUCKET_KINDS = (EQUAL_WIDTH, EQUAL_COUNT)
MEAN_AXIS, CONE_UNION = "mean", "union"
CONE_AXES = (MEAN_AXIS, CONE_UNION)
MOMENTS, CLAMPED, CUT_OFF = "moments", "clamped", "cutoff"
IMPORTANCES = (MOMENTS, CLAMPED, CUT_OFF)
MOMENTS_ID, CUT_OFF_ID = IMPORTANCES.index(MOMENTS), IMPORTANCES.index(CUT_OFF)
MAX_BUCKETS = 4096


@dataclass(frozen=True)
class TreeOptions:
    """The defaults are what measures best; the others are there to be compared with them.

    Parameters
    ----------
    split : how a set of lights is cut in two: "saoh" (surface area orientation heuristic of Conty
        and Kulla), "sah" (surface area alone), "middle" (halfway along the longest side), "equal"
        (as many lights on either side of it)
    thin_box : whether saoh counts cuts across the shorter sides of a box as costlier
    buckets : candidate cuts along each side are the bounds of so many buckets; 0 for all cuts
    bucket_kind : buckets of equal "width", or of equal "count"
    cone_axis : axis of a set while cuts are compared: the "mean" of its lights' axes, or that of
        the cone "union" of its lights' cones
    width : children of a node, 2 to 16
    importance : "moments" (see importance.py), or from bounds alone (see bounds.py): "clamped" as
        by Conty and Kulla, "cutoff" as in Ma's thesis
    split_threshold : a set of lights whose distances from the point vary by a smaller share than
        this gets one light sample at most; 0: every set may get more, 1: none, no splitting
    """

    split: str = SAOH
    thin_box: bool = True
    buckets: int = 16
    bucket_kind: str = EQUAL_WIDTH
    cone_axis: str = MEAN_AXIS
    width: int = NUM_LANES
    importance: str = MOMENTS
    split_threshold: float = 0.0

    def check(self) -> None:
        """Raise ValueError, naming the option, if one makes no sense."""
        for name, allowed in (
            ("split", SPLITS),
            ("bucket_kind", BUCKET_KINDS),
            ("cone_axis", CONE_AXES),
            ("importance", IMPORTANCES),
        ):
            value = getattr(self, name)
            if value not in allowed:
                raise ValueError(f"{name} must be one of {', '.join(allowed)}, not {value!r}")
        for name, least, most in (
            ("buckets", 0, MAX_BUCKETS),
            ("width", 2, NUM_LANES),
            ("split_threshold", 0, 1),
        ):
            value = getattr(self, name)
            if not least <= value <= most:
                raise ValueError(f"{name} must be between {least} and {most}, not {value}")
        if self.buckets == 1:
            raise ValueError(
                "buckets must be 0 for all cuts, or 2 and more; 1 leaves nothing to cut"
            )

    @classmethod
    def parse(cls, texts: list[str]) -> TreeOptions:
        """From "name=value" texts; raise ValueError, naming the text, for one it cannot read."""
        known = {field.name: type(field.default) for field in fields(cls)}
        values = {}
        for text in texts:
            name, _, value = text.partition("=")
            if name not in known:
                raise ValueError(
                    f"{text!r}: there is no tree option {name!r}, only {', '.join(known)}"
                )
            try:
                values[name] = _READERS[known[name]](value)
            except (KeyError, ValueError):
                kind = known[name].__name__
                raise ValueError(f"{text!r}: {value!r} is not {_KINDS[kind]}") from None
        options = replace(cls(), **values)
        options.check()
        return options


_READERS = {
    str: str,
    int: int,
    float: float,
    bool: {"on": True, "off": False, "yes": True, "no": False, "1": True, "0": False}.__getitem__,
}
_KINDS = {"int": "a whole number", "float": "a number", "bool": "on or off", "str": "a name"}
