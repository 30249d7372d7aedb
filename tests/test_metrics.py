"""Errors have known answers, ignore scale, and a result folder becomes results.csv."""

import csv
import json

import flip_evaluator
import numpy as np
import pytest
from result_folder import (
    NOISE,
    REFERENCE_NOISE,
    SCENE,
    SPEED,
    add_noise,
    paint_street,
    write_image,
    write_result_folder,
)

from lighttree_batch import metrics
from lighttree_batch.images import ImageError, read_exr, write_exr

STREET = paint_street()


def rng():
    return np.random.default_rng(7)


@pytest.fixture(autouse=True)
def fast_flip(request, monkeypatch):
    """FLIP takes a tenth of a second an image; only the tests with it in their name need it."""
    if "flip" not in request.node.name:
        monkeypatch.setattr(metrics, "flip", lambda image, reference: (0.25, image[..., 0]))


@pytest.fixture
def results(tmp_path):
    folder = write_result_folder(tmp_path / "results")
    rows, _ = metrics.collect_results(folder)
    metrics.write_results(folder, rows)
    return folder, rows


def test_the_reference_itself_has_no_error_and_no_flip():
    street = np.maximum(paint_street(32, 24), 0.1)
    errors = metrics.measure(street, street)
    assert errors.pop("mean_ratio") == 1
    assert set(errors) == set(metrics.ERROR_COLUMNS)
    assert all(error == 0 for error in errors.values())


def test_a_uniform_error_has_the_answer_of_the_formula():
    gray = np.full((8, 8, 3), 2.0, np.float32)
    errors = metrics.measure(gray * 1.5, gray)
    relative_sq = 0.5**2 / (1 + metrics.EPS_SHARE)
    assert errors["rel_mse"] == pytest.approx(relative_sq)
    assert errors["rel_mse_trimmed"] == pytest.approx(relative_sq)
    assert errors["mse"] == pytest.approx(1.0)
    assert errors["mean_abs"] == pytest.approx(1.0)
    assert errors["p50"] == errors["p99"] == pytest.approx(relative_sq**0.5)
    assert errors["mean_ratio"] == pytest.approx(1.5)


@pytest.mark.parametrize("scale", [1e-5, 1e4])
def test_relative_errors_ignore_the_scale_of_the_scene(scale):
    noisy = add_noise(STREET, 0.3, rng())
    errors = metrics.measure(noisy, STREET)
    scaled = metrics.measure(noisy * np.float32(scale), STREET * np.float32(scale))
    for name in ("rel_mse", "rel_mse_trimmed", "p50", "p90", "p99", "mean_ratio"):
        assert scaled[name] == pytest.approx(errors[name], rel=1e-4)


def test_black_pixels_of_the_reference_do_not_explode():
    half_black = STREET.copy()
    half_black[:, 32:] = 0
    errors = metrics.measure(half_black + np.float32(1e-3), half_black)
    assert errors["p99"] < 1  # 1e-3 is little beside the mean luminance of 0.1


def test_the_error_of_noise_is_its_relative_variance():
    # 3072 pixels of gamma noise: the mean of their squares scatters by sqrt((2 + 6 v) / 3072),
    # here 0.03; 4 of them, and eps takes at most 1 % of bright and much of dark pixels.
    image = np.maximum(STREET, 1.0)
    for variance in (0.1, 0.2):
        error = metrics.measure(add_noise(image, variance, rng()), image)["rel_mse"]
        assert error == pytest.approx(variance / 1.01, rel=0.13)


def test_trimming_removes_fireflies_and_hardly_anything_else():
    noisy = add_noise(STREET, 0.05, rng())
    before = metrics.measure(noisy, STREET)
    noisy[10, 10] += 1e4  # one of 3072 pixels, 0.03 %
    after = metrics.measure(noisy, STREET)
    assert after["rel_mse"] > 1e6 * before["rel_mse"]
    assert after["rel_mse_trimmed"] == pytest.approx(before["rel_mse_trimmed"], rel=0.05)
    assert before["rel_mse_trimmed"] == pytest.approx(before["rel_mse"], rel=0.1)


def test_flip_grows_with_noise_whatever_the_scale():
    street = np.maximum(paint_street(32, 24), 0.1)  # few stops, so few exposures to compare
    flips = [metrics.flip(add_noise(street, v, rng()), street)[0] for v in (0.01, 0.1, 1)]
    assert flips == sorted(flips)
    assert 0 < flips[0] < flips[2] < 1
    dim = street * np.float32(1e-9)
    assert metrics.flip(add_noise(dim, 0.1, rng()), dim)[0] == pytest.approx(flips[1], rel=0.01)


def test_flip_survives_nights_that_are_black_but_for_a_lamp():
    black = np.zeros((24, 32, 3), np.float32)
    lamp = black.copy()
    lamp[3, 3] = 1e4
    for reference in (black, lamp):
        mean, error = metrics.flip(reference, reference)
        assert mean == 0
        assert error.shape == (24, 32)
    assert metrics.flip(lamp, black)[0] > 0


def test_flip_takes_its_own_exposures_where_no_pixel_is_black():
    street = np.maximum(paint_street(32, 24), 0.1)
    noisy = add_noise(street, 0.3, rng())
    _, mean, _ = flip_evaluator.evaluate(street, noisy, "HDR", applyMagma=False)
    assert metrics.flip(noisy, street)[0] == pytest.approx(mean, rel=1e-3)


def test_flip_alone_is_unknown_without_its_package(monkeypatch):
    monkeypatch.setattr(metrics, "flip_evaluator", None)
    errors = metrics.measure(add_noise(STREET, 0.3, rng()), STREET)
    assert [name for name, error in errors.items() if np.isnan(error)] == ["flip"]


def test_the_noise_floor_is_the_error_of_a_reference_against_the_truth():
    noisy = add_noise(STREET, 0.01, rng())
    floor = metrics.noise_floor(STREET, 0.01 * np.square(STREET))
    assert floor == pytest.approx(metrics.measure(noisy, STREET)["rel_mse"], rel=0.15)


def compare_noisy(a, b, variance=0.01):
    """compare_models on two noisy versions of images."""
    noise = rng()
    noisy = [add_noise(image, variance, noise) for image in (a, b)]
    variances = [variance * np.square(image) for image in (a, b)]
    return metrics.compare_models(noisy[0], variances[0], noisy[1], variances[1])


def test_equal_models_agree_within_noise():
    check = compare_noisy(STREET, STREET)
    assert check.tile_z.shape == (3, 4)
    assert check.share_within_3 == 1
    assert abs(check.mean_ratio - 1) < 3 * check.mean_ratio_sigma
    assert check.mean_ratio_sigma < 0.02
    # The relative variance of the difference, 0.02, is taken off but for its own scatter.
    assert abs(check.difference_sq) < 3 * check.difference_sq_sigma < 0.01


def test_tile_differences_are_counted_in_standard_errors():
    image = np.ones((160, 160, 3), np.float32)
    z = compare_noisy(image, image).tile_z
    assert z.std() == pytest.approx(1, abs=0.2)  # 100 tiles: 1 +- 0.07
    assert abs(z.mean()) < 0.3


def test_a_model_difference_is_found_where_it_is():
    brighter = STREET.copy()
    brighter[:16, :32] *= 1.2
    check = compare_noisy(brighter, STREET)
    outside = np.abs(check.tile_z) > 3
    assert outside[0, :2].all()
    assert (check.tile_z[0, :2] > 0).all()
    assert outside.sum() == 2
    # 0.2 of the mean of both in 2 of 12 tiles, weakened by eps where the sky is dark.
    difference = metrics.compare_models(brighter, 0 * STREET, STREET, 0 * STREET).difference_sq
    assert check.difference_sq == pytest.approx(difference, abs=3 * check.difference_sq_sigma)
    assert compare_noisy(1.05 * STREET, STREET).mean_ratio == pytest.approx(1.05, abs=0.03)


def test_tiles_cut_by_the_border_count_and_rounding_does_not():
    image = np.ones((17, 40, 3), np.float32)
    other = image.copy()
    other[16, 39] = 2  # in the smallest tile, 1 x 8 pixels
    other[0, 0] += 1e-6  # no noise, but less than rounding
    check = metrics.compare_models(other, 0 * image, image, 0 * image)
    np.testing.assert_array_equal(check.tile_z > 3, [[0, 0, 0], [0, 0, 1]])
    assert check.share_within_3 == pytest.approx(5 / 6)


def test_efficiency_doubles_when_time_or_error_halves():
    assert metrics.efficiency(0.5, 4) == 0.5
    assert metrics.efficiency(0.25, 4) == metrics.efficiency(0.5, 2) == 1
    assert np.isnan(metrics.efficiency(0, 4))


def test_every_render_has_a_row_in_order_and_its_expected_error(results):
    _, rows = results
    order = [(m, f"{b}s", s) for m in SPEED for b in (1, 2, 4, 8) for s in (1, 2)]
    assert [(row["method"], row["budget"], row["seed"]) for row in rows] == order
    for row in rows:
        # eps lowers it, so a third of the variance is enough; fireflies scatter it upwards.
        expected = NOISE / (int(row["budget"][:-1]) * SPEED[row["method"]]) + REFERENCE_NOISE / 2
        assert 0.3 * expected < row["rel_mse"] < 1.5 * expected


def test_results_csv_has_the_columns_others_build_on(results):
    folder, rows = results
    with (folder / "results.csv").open(newline="") as file:
        table = list(csv.reader(file))
    assert ",".join(table[0]) == (
        "scene,method,seed,samples,seconds_render,seconds_setup,rel_mse,rel_mse_trimmed,mse,"
        "mean_abs,flip,p50,p90,p99,mean_ratio,peak_mib,budget,cpu,seconds_compile"
    )
    assert len(table) == 1 + len(rows)
    assert [float(cell) for cell in table[1][2:-3]] == [rows[0][c] for c in table[0][2:-3]]
    assert table[1][-3:] == ["1s", "Example CPU", "0.5"]


def test_images_of_the_version_that_did_not_tell_compiling_are_measured(tmp_path):
    folder = write_result_folder(tmp_path / "results", speed={"cycles": 1}, budgets=(1,))
    for path in (folder / SCENE).glob("cycles-*.exr"):
        channels, header = read_exr(path)
        del header["seconds_compile"]
        write_exr(path, channels, header)
    rows, problems = metrics.collect_results(folder)
    assert len(rows) == 2 and not problems
    metrics.write_results(folder, rows)
    first = next(csv.DictReader((folder / "results.csv").open()))
    assert first["seconds_compile"] == "" and float(first["rel_mse"]) > 0


def test_without_a_reference_rows_have_empty_errors(tmp_path):
    folder = write_result_folder(tmp_path / "results", speed={"cycles": 1})
    (folder / SCENE / "reference.exr").unlink()
    rows, problems = metrics.collect_results(folder)
    assert len(rows) == 8
    assert "no such file" in problems[0] and "has no errors" in problems[0]
    metrics.write_results(folder, rows)
    first = next(csv.DictReader((folder / "results.csv").open()))
    assert (first["rel_mse"], first["peak_mib"]) == ("", "512.0")


def test_what_cannot_be_compared_is_left_out_and_told(tmp_path):
    folder = write_result_folder(tmp_path / "results", speed={"cycles": 1})
    scene = folder / SCENE

    def spoil(name, **changes):
        channels, header = read_exr(scene / f"{name}.exr")
        rgb = np.stack([channels[c] for c in "RGB"], axis=-1)
        rgb[0, 0] = changes.pop("pixel", rgb[0, 0])
        write_image(scene / f"{name}.exr", rgb[changes.pop("first_row", 0) :], header | changes)

    spoil("cycles-1s-seed1", pixel=np.nan)
    spoil("cycles-1s-seed2", threads=64)
    spoil("cycles-2s-seed1", first_row=8)
    (scene / "cycles-2s-seed2.exr").write_bytes(b"")
    (scene / "cycles-4s-seed1.exr").unlink()
    (scene / "cycles-4s-seed2.exr").rename(scene / "cycles-16s-seed2.exr")
    rows, problems = metrics.collect_results(folder)
    assert [row["budget"] for row in rows] == ["8s", "8s"]
    told = "\n".join(problems)
    assert f"{SCENE}/cycles-1s-seed1.exr: 1 pixels are NaN or infinite." in told
    assert "cycles-1s-seed2.exr: threads 64, not 2 as in run.json." in told
    assert "cycles-2s-seed1.exr: is (40, 64, 3), the reference (48, 64, 3)." in told
    assert "cycles-2s-seed2.exr: not a readable OpenEXR file" in told
    assert "2 of 8 renders are missing: cycles-4s-seed1, cycles-4s-seed2." in told
    assert "not in run.json, so left out: cycles-16s-seed2." in told


def test_renders_by_another_machine_are_left_out_and_told(tmp_path):
    folder = write_result_folder(tmp_path / "results", speed={"cycles": 1})
    for name in ("cycles-1s-seed1", "cycles-8s-seed2"):
        path = folder / SCENE / f"{name}.exr"
        channels, header = read_exr(path)
        write_exr(path, channels, header | {"machine": {"cpu": "Fast CPU"}})
    rows, problems = metrics.collect_results(folder)
    assert len(rows) == 6 and {row["cpu"] for row in rows} == {"Example CPU"}
    assert problems == [
        f"{SCENE}: 2 renders by another machine (Fast CPU; the others are by Example CPU), so "
        "left out."
    ]


def test_a_folder_without_a_run_is_refused_by_name(tmp_path):
    with pytest.raises(ImageError, match=r"no run\.json; `lighttree compare` writes it"):
        metrics.collect_results(tmp_path)
    (tmp_path / "run.json").write_text("{")
    with pytest.raises(ImageError, match=r"run\.json: damaged"):
        metrics.collect_results(tmp_path)
    (tmp_path / "run.json").write_text(json.dumps({"format": 2}))
    with pytest.raises(ImageError, match="expected format 1, found 2"):
        metrics.collect_results(tmp_path)


def test_progress_runs_from_nothing_to_less_than_all(tmp_path):
    folder = write_result_folder(tmp_path / "results", speed={"cycles": 1})
    told = []
    metrics.collect_results(folder, lambda fraction, text: told.append((fraction, text)))
    assert told[0] == (0, f"Measuring {SCENE} cycles-1s-seed1")
    assert [fraction for fraction, _ in told] == [k / 8 for k in range(8)]
