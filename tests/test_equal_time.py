"""Comparisons at equal time, the words for them, and where plots put them."""

import numpy as np
import pytest

from lighttree_batch import equal_time, plots, wording
from lighttree_batch.methods import METHODS


def test_the_interval_over_seeds_is_students():
    # Known quantiles; the last is a normal distribution's.
    for dof, t in ((1, 12.706), (2, 4.303), (5.5, 2.502), (9, 2.262), (1e5, 1.960)):
        assert equal_time.student_t(dof) == pytest.approx(t, rel=1e-3)

    def rows(*costs):
        return [
            {"seed": seed, "rel_mse": cost, "seconds_render": 1.0, "seconds_setup": 0.0}
            for seed, cost in enumerate(costs)
        ]

    ours, theirs = rows(1.0, np.e), rows(5.0, 5.0)
    mean, low, high = equal_time.confidence_interval([(ours, theirs)])
    # Two logarithms 1 apart: the standard error of their mean is 0.5, of one degree of freedom.
    assert np.log([mean / low, high / mean]) == pytest.approx(0.5 * 12.706, rel=1e-3)
    assert equal_time.confidence_interval([(theirs, theirs)]) == (1, 1, 1)
    assert equal_time.confidence_interval([(ours, theirs), (rows(1.0), theirs)]) is None


def test_the_interval_of_two_seeds_holds_the_truth_as_often_as_it_says():
    rng = np.random.default_rng(7)

    def rows(scale):
        return [
            {"seed": seed, "rel_mse": cost, "seconds_render": 1.0, "seconds_setup": 0.0}
            for seed, cost in enumerate(scale * np.exp(rng.normal(0, 0.2, 2)))
        ]

    held = 0
    for _ in range(400):
        pairs = [(rows(1.0), rows(3.0)) for _ in range(2)]
        _, low, high = equal_time.confidence_interval(pairs)
        held += low <= 3 <= high
    # Welch's count of degrees of freedom errs to the wide side: 0.978 in 1,500 trials, of which
    # 0.022 are three standard errors here. With a normal distribution's 1.96 it were below 0.9.
    assert 0.95 < held / 400 < 1


def test_percentiles_are_placed_by_size():
    entry = {name: equal_time.Spread(value, value, value) for name, value in
             (("p50", 0.01), ("p90", 0.1), ("p99", 1.0))}  # fmt: skip
    placed = plots.place_percentiles([entry | {"method": "cycles"}])
    p50, p90, p99 = placed["bars"]["cycles"]
    assert 0 < p50 < p90 < p99 < 100
    assert p90 - p50 == pytest.approx(p99 - p90, abs=0.2)
    assert {(p50, "1"), (p90, "10"), (p99, "100")} <= set(placed["ticks"])
    black = entry | {"p50": equal_time.Spread(0.0, 0.0, 0.0), "method": "lighttree"}
    assert plots.place_percentiles([black])["bars"]["lighttree"][0] == 0


@pytest.mark.parametrize("ends", [(0.9, 1.1), (1, 3), (0.5, 16), (1e-5, 40), (3e-9, 5e9), (98, 99)])
def test_an_axis_has_two_to_eight_round_ticks(ends):
    ticks = plots.pick_ticks(*ends)
    assert 2 <= len(ticks) <= plots.MAX_TICKS
    for tick in ticks:
        assert ends[0] * 0.95 <= tick <= ends[1] * 1.05
        assert float(f"{tick:.2g}") == pytest.approx(tick)


def test_every_method_keeps_its_own_colour():
    colors = [color for color, _ in plots.STYLES.values()]
    assert len(set(colors)) == len(colors)
    assert set(plots.STYLES) == set(METHODS)


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (0.0434567, "0.0435"), (17.34, "17.3"), (1234.5, "1,234"), (8, "8"), (1000, "1,000"),
        (1.0, "1.00"), (0.0, "0.00"), (999.96, "1,000"), (np.float64(0.07), "0.0700"),
        (1.2e-5, "1.20&nbsp;&times;&nbsp;10<sup>-5</sup>"), (np.nan, "&ndash;"), (None, "&ndash;"),
    ],
)  # fmt: skip
def test_numbers_have_three_digits(value, text):
    assert str(wording.format_number(value)) == text


def test_ratios_are_put_into_words_that_cannot_be_misread():
    assert wording.format_comparative(3.1) == "3.10 times lower"
    assert wording.format_comparative(0.5) == "2.00 times higher"
    spread = equal_time.Spread
    assert wording.format_comparative_range(spread(3.0, 2.0, 4.0)) == "2.00 to 4.00 times lower"
    assert wording.format_comparative_range(spread(0.3, 0.25, 0.5)) == "2.00 to 4.00 times higher"
    across = wording.format_comparative_range(spread(1.0, 0.5, 2.0))
    assert across == "2.00 times higher to 2.00 times lower"
