"""A job of two small scenes as if they had been inspected, without Blender."""

from lighttree_batch import facts
from lighttree_batch.jobs import read_job
from lighttree_batch.plan import plan_scene

JOB = """
methods = ["lighttree", "cycles"]
seconds = [1, 4]
seeds = 1
resolution = [12, 8]
threads = 1
[[scene]]
files = ["a.blend", "b.blend"]
"""


def write_job(folder):
    """Its job, of a file jobs.toml in the folder."""
    for name in ("a", "b"):
        (folder / f"{name}.blend").write_text(name)
    (folder / "jobs.toml").write_text(JOB)
    job = read_job(folder / "jobs.toml")
    for source in job.sources:
        found = {"camera": "c", "frame": 1, "lights": {}, "triangles": 0, "not_modelled": []}
        found |= {"scene": "Scene", "view_layer": "ViewLayer"}
        found |= {"files": [], "fixed_files": [], "file_sha256": facts.hash_files([source.file])}
        found |= {"renderers": facts.describe_renderers(), "versions": facts.describe_packages()}
        (job.out / source.name).mkdir(parents=True)
        facts.save_facts(found, source, job.out / source.name)
    return job


def list_units(job):
    """Those of the first scene, sixteen parts of references and four renders, then the second's."""
    return [
        unit
        for source in job.sources
        for unit in plan_scene(
            source, facts.load_facts(job.out / source.name), job.out, job.options
        ).units
    ]
