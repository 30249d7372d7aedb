"""results.sqlite keeps every version's rows, and tells a regression from noise."""

import json
import sqlite3
from contextlib import closing

import numpy as np
import pytest
from result_folder import SCENE, write_result_folder

from lighttree_batch import metrics, report
from lighttree_batch.__main__ import main
from lighttree_batch.history import Entry, read_history, tell_change
from lighttree_batch.images import ImageError, read_exr, write_exr

# As the version before `seconds_compile` created its table.
OLD_KEY = (
    "renderer, seed, scene, file_sha256, method, overrides, budget, resolution, bounces, threads, "
    "cpu"
)
OLD_COLUMNS = (
    f"{OLD_KEY}, started, command, versions, platform, samples, seconds_render, seconds_setup, "
    "rel_mse, rel_mse_trimmed, mse, mean_abs, flip, p50, p90, p99, mean_ratio, peak_mib"
)


@pytest.fixture(autouse=True)
def fast_flip(monkeypatch):
    monkeypatch.setattr(metrics, "flip", lambda image, reference: (0.25, image[..., 0]))


def measure(folder, version, started, factor=1.0, seeds=2):
    """Write the report of what `version` rendered, `factor` times the usual seconds."""
    write_result_folder(folder, size=(32, 24), speed={"lighttree": 8, "cycles": 4}, budgets=(2,))
    run = json.loads((folder / "run.json").read_text()) | {"started": started, "seeds": seeds}
    (folder / "run.json").write_text(json.dumps(run))
    for path in (folder / SCENE).glob("lighttree-*.exr"):
        channels, header = read_exr(path)
        header["settings"] |= {"renderer": f"LightTree {version}", "file_sha256": "ab"}
        header["seconds_render"] *= factor
        write_exr(path, channels, header)
    report.write_report(folder)


def remeasure(folder, *args, **options):
    """The same folder, rendered anew."""
    for path in (folder / SCENE).iterdir():
        path.unlink()
    (folder / SCENE).rmdir()
    measure(folder, *args, **options)


def test_a_version_that_became_slower_is_flagged_and_the_same_is_not(tmp_path, capsys):
    folder = tmp_path / "results"
    measure(folder, "1 aa", "2026-01-01")
    remeasure(folder, "2 bb", "2026-02-01", factor=1.0001)
    remeasure(folder, "3 cc", "2026-03-01", factor=20)
    remeasure(folder, "4 dd", "2026-04-01", factor=1)
    entries = read_history(folder, "lighttree")
    assert [entry.renderer[-2:] for entry in entries] == ["aa", "bb", "cc", "dd"]
    assert [entry.is_worse for entry in entries] == [False, False, True, False]
    assert entries[0].against is None and entries[2].against.mean == pytest.approx(1 / 20, rel=0.01)
    assert "better" in tell_change(entries[3]) and "the same" in tell_change(entries[1])
    assert main(["history", str(folder)]) == 0
    printed = capsys.readouterr().out
    assert "1 of 4 rows are worse than the version before; by chance" in printed
    assert printed.count("WORSE: 20") == 1 and "LightTree 3 cc" in printed


def test_measuring_again_adds_nothing_and_keeps_the_first_date(tmp_path):
    folder = tmp_path / "results"
    measure(folder, "1 aa", "2026-01-01")
    run = json.loads((folder / "run.json").read_text()) | {"started": "2026-09-09"}
    (folder / "run.json").write_text(json.dumps(run))
    report.write_report(folder)
    with closing(sqlite3.connect(folder / "results.sqlite")) as database:
        rows = database.execute("SELECT started, versions, cpu, rel_mse FROM results").fetchall()
    assert len(rows) == 4 and {row[0] for row in rows} == {"2026-01-01"}
    assert json.loads(rows[0][1])["blender"] == "5.2.3" and rows[0][2] == "Example CPU"
    measured = [row["rel_mse"] for row in metrics.collect_results(folder)[0]]
    assert sorted(row[3] for row in rows) == pytest.approx(sorted(measured))


def test_other_machines_are_not_compared(tmp_path):
    folder = tmp_path / "results"
    measure(folder, "1 aa", "2026-01-01")
    remeasure(folder, "2 bb", "2026-02-01", factor=20)
    with closing(sqlite3.connect(folder / "results.sqlite")) as database, database:
        database.execute("UPDATE results SET cpu = 'Other' WHERE renderer LIKE '%aa'")
    assert [entry.against for entry in read_history(folder, "lighttree")] == [None, None]


def test_a_database_of_the_version_before_gets_the_new_columns(tmp_path):
    folder = tmp_path / "results"
    measure(folder, "1 aa", "2026-01-01")
    with closing(sqlite3.connect(folder / "results.sqlite")) as database:
        rows = database.execute(f"SELECT {OLD_COLUMNS} FROM results").fetchall()
    (folder / "results.sqlite").unlink()
    with closing(sqlite3.connect(folder / "results.sqlite")) as database, database:
        database.execute(f"CREATE TABLE results ({OLD_COLUMNS}, PRIMARY KEY ({OLD_KEY}))")
        places = ", ".join("?" * len(rows[0]))
        database.executemany(f"INSERT INTO results VALUES ({places})", rows)
    assert [entry.renderer for entry in read_history(folder, "lighttree")] == ["LightTree 1 aa"]
    remeasure(folder, "2 bb", "2026-02-01")
    assert [entry.renderer[-2:] for entry in read_history(folder, "lighttree")] == ["aa", "bb"]
    with closing(sqlite3.connect(folder / "results.sqlite")) as database:
        # Those of before are as they were, and what they did not tell is unknown.
        is_old = "WHERE renderer = 'LightTree 1 aa'"
        again = database.execute(f"SELECT {OLD_COLUMNS} FROM results {is_old}").fetchall()
        assert again == [row for row in rows if row[0] == "LightTree 1 aa"] and len(again) == 2
        told = database.execute(
            "SELECT DISTINCT renderer, seconds_compile FROM results WHERE method = 'lighttree'"
        ).fetchall()
    assert sorted(told) == [("LightTree 1 aa", None), ("LightTree 2 bb", 0.5)]


def test_one_seed_tells_no_regression(tmp_path):
    folder = tmp_path / "results"
    measure(folder, "1 aa", "2026-01-01", seeds=1)
    remeasure(folder, "2 bb", "2026-02-01", factor=20, seeds=1)
    last = read_history(folder, "lighttree")[-1]
    assert isinstance(last, Entry) and not last.is_worse
    assert "two seeds" in tell_change(last)


def test_unknown_numbers_stay_unknown(tmp_path):
    folder = tmp_path / "results"
    write_result_folder(folder, size=(32, 24), speed={"lighttree": 8}, budgets=(2,))
    (folder / SCENE / "reference.exr").unlink()
    report.write_report(folder)
    with closing(sqlite3.connect(folder / "results.sqlite")) as database:
        assert database.execute("SELECT rel_mse FROM results").fetchall() == [(None,), (None,)]
    with pytest.raises(ImageError, match="only nothing measured"):
        read_history(folder, "lighttree")


def test_what_is_not_there_is_told(tmp_path):
    with pytest.raises(ImageError, match="`lighttree report` writes it"):
        read_history(tmp_path, "lighttree")
    measure(tmp_path / "results", "1 aa", "2026-01-01")
    with pytest.raises(ImageError, match=r"no 'magic' .*, only cycles, lighttree"):
        read_history(tmp_path / "results", "magic")
    (tmp_path / "results.sqlite").write_bytes(np.random.default_rng(7).bytes(5000))
    with pytest.raises(ImageError, match="not a database; move it away"):
        read_history(tmp_path, "lighttree")
    with closing(sqlite3.connect(tmp_path / "results" / "results.sqlite")) as database, database:
        database.execute("DROP TABLE results")
        database.execute("CREATE VIEW results AS SELECT 1 AS flip")
    with pytest.raises(ImageError, match="move it away"):
        report.write_report(tmp_path / "results")
