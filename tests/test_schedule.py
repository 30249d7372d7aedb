"""What renders where and when: machines, kinds of CPU, and workers that are lost."""

import threading
import time
from collections import Counter
from contextlib import nullcontext

import numpy as np
import pytest

from lighttree_batch import plan
from lighttree_batch.images import write_exr
from lighttree_batch.process import RenderError
from lighttree_batch.schedule import Schedule, WorkerLost

FACTS = {"camera": "c", "frame": 1, "scene": "Scene", "view_layer": "ViewLayer"}
FACTS |= {"file_sha256": "0", "lights": {}, "triangles": 0}
FACTS |= {"not_modelled": [], "renderers": {"LIGHTTREE": "L", "CYCLES": "C"}}
FACTS |= {"files": [], "fixed_files": []}
RENDERED = {"samples": 4, "seconds_render": 1.0, "seconds_setup": 0.5}


class FakeWorker:
    """Renders noise, and notes beside what; `lost` says at which of its units it is lost."""

    at_work: list = []
    lock = threading.Lock()

    def __init__(self, machine, cpu="A", lost=()):
        self.machine, self.cpu, self.lost, self.rendered = machine, cpu, lost, []

    def render(self, plan, unit, advance):
        with self.lock:
            beside = [other for machine, other in self.at_work if machine == self.machine]
            assert not beside or not any(u.is_timed for u in [unit, *beside])
            self.at_work.append((self.machine, unit))
        try:
            time.sleep(0.002)
            advance(0.5, "Rendering")
            if len(self.rendered) in self.lost:
                raise WorkerLost(f"{self.machine} is gone.")
            self.rendered.append(unit)
            unit.path.parent.mkdir(parents=True, exist_ok=True)
            pixels = np.random.default_rng(unit.header["seed"]).random((3, 8, 12), np.float32)
            write_exr(unit.path, dict(zip("RGB", pixels, strict=True)), unit.header | RENDERED)
        finally:
            self.at_work.remove((self.machine, unit))


class FakeCrew(nullcontext):
    """Workers that come when a list of them is due."""

    def __init__(self, *shifts, patience_s=0.0):
        super().__init__()
        self.shifts, self.patience_s = list(shifts), patience_s

    def find_new(self):
        return self.shifts.pop(0) if self.shifts else []


def make_plans(folder, scenes=("a", "b"), **changes):
    given = {"methods": ("lighttree", "cycles"), "budgets": (1, 4), "resolution": (12, 8)}
    options = plan.Options(**given | {"reference_samples": 8} | changes)
    return [plan.plan_scene(plan.Source(f"{s}.blend"), FACTS, folder, options) for s in scenes]


def run(plans, crew, cpus=()):
    units = [unit for scene in plans for unit in scene.units]
    Schedule(plans, units, dict(cpus), crew, lambda *_: None, lambda: None).run()
    return units


@pytest.mark.parametrize("kind", ["seconds", "samples"])
def test_scenes_stay_with_one_cpu_and_timed_renders_have_their_machine_alone(tmp_path, kind):
    workers = [FakeWorker(machine, cpu) for machine, cpu in ("1A", "1A", "2A", "3B", "3B")]
    plans = make_plans(tmp_path, "abcdef", budget_kind=kind)
    units = run(plans, FakeCrew(workers))
    rendered = [unit.path for worker in workers for unit in worker.rendered]
    assert Counter(rendered) == Counter(unit.path for unit in units)
    for scene in plans:
        assert (scene.folder / "reference.exr").exists() and not scene.entry["failed"]
        cpus = {w.cpu for w in workers for u in w.rendered if u in scene.renders}
        assert len(cpus) == 1
    assert len({w.cpu for w in workers if w.rendered}) == 2


def test_what_a_lost_worker_had_is_rendered_by_another(tmp_path):
    lost, last = FakeWorker("1", lost=[2]), FakeWorker("2")
    plans = make_plans(tmp_path)
    units = run(plans, FakeCrew([lost], [], [last], patience_s=30))
    assert len(lost.rendered) == 2 and len(last.rendered) == len(units) - 2
    assert not any(scene.entry["failed"] for scene in plans)


def test_a_scene_is_not_bound_to_a_lost_worker_that_rendered_nothing_of_it(tmp_path):
    plans = make_plans(tmp_path, "a", references=())
    crew = FakeCrew([FakeWorker("1", "A", lost=[0])], [FakeWorker("2", "B")], patience_s=30)
    units = run(plans, crew)
    assert all(unit.path.exists() for unit in units) and not plans[0].entry["failed"]


def test_a_unit_that_takes_its_workers_along_has_failed(tmp_path):
    workers = [FakeWorker(str(k), lost=[0]) for k in range(3)]
    plans = make_plans(tmp_path, "a")
    shifts = [[worker] for worker in [*workers, FakeWorker("9")]]
    units = run(plans, FakeCrew(*shifts, patience_s=30))
    (missing,) = [unit for unit in units if not unit.path.exists()]
    assert plans[0].entry["failed"] == [f"{missing.path.stem}: 2 is gone."]
    assert (plans[0].folder / "reference.exr").exists()


def test_renders_that_would_be_by_another_cpu_are_told_and_chunks_are_rendered(tmp_path):
    plans = make_plans(tmp_path)
    run(plans, FakeCrew([FakeWorker("1", "B")]), {plans[0].folder: "A"})
    (sentence,) = plans[0].entry["failed"]
    assert sentence.startswith("8 renders: The others of this scene were made by another CPU, A;")
    assert (plans[0].folder / "reference.exr").exists() and not plans[1].entry["failed"]
    assert not any(unit.path.exists() for unit in plans[0].renders)


def test_without_workers_a_batch_ends_with_a_sentence(tmp_path):
    plans = make_plans(tmp_path)
    with pytest.raises(RenderError, match="No worker is left; start one"):
        run(plans, FakeCrew([FakeWorker("1", lost=[3])]))
    assert len(list(tmp_path.rglob("*.exr"))) == 3


@pytest.mark.parametrize("is_last", [False, True])
def test_a_fault_of_ours_ends_all_workers(tmp_path, is_last):
    class Faulty(FakeWorker):
        def render(self, plan, unit, advance):
            if not is_last or len(self.rendered) == 23:
                raise ZeroDivisionError
            super().render(plan, unit, advance)

    before = threading.active_count()
    others = [] if is_last else [FakeWorker("1")]
    with pytest.raises(ZeroDivisionError):
        run(make_plans(tmp_path, "a"), FakeCrew([*others, Faulty("2")]))
    assert threading.active_count() == before
