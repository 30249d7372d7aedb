"""A real scheduler with real workers on loopback: what they render, what they lose, who gets in."""

import logging
import os
import shutil
import signal
import subprocess
import sys
import time
from contextlib import ExitStack, contextmanager
from pathlib import Path

import psutil
import pytest
import trustme
from distributed import Client
from shot_batch import assert_same_images

from lighttree_batch import experiment, serving
from lighttree_batch.cluster import ClusterCrew
from lighttree_batch.experiment import run_batch
from lighttree_batch.facts import describe_machine, describe_renderers
from lighttree_batch.images import read_exr
from lighttree_batch.methods import InputError
from lighttree_batch.plan import Options, Source
from lighttree_batch.process import RenderError

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="sends SIGKILL")

SAVE_SHOP = """
import bpy, sys
folder = sys.argv[1]
bpy.ops.wm.read_factory_settings()
image = bpy.data.images.new("sign", 4, 4)
image.pixels = [0.9, 0.2, 0.1, 1.0] * 16
image.filepath_raw, image.file_format = folder + "/signs/sign.png", "PNG"
image.save()
material = bpy.data.objects["Cube"].data.materials[0]
material.use_nodes = True
nodes = material.node_tree.nodes
nodes.new("ShaderNodeTexImage").image = image
material.node_tree.links.new(nodes[-1].outputs[0], nodes["Principled BSDF"].inputs[0])
bpy.ops.wm.save_as_mainfile(filepath=folder + "/shop.blend", compress=False)
getattr(bpy.ops.file, "make_paths_" + sys.argv[2])()
bpy.ops.wm.save_mainfile(relative_remap=False)
"""
OPTIONS = Options(
    ("lighttree", "cycles"), "samples", (16, 2048), 1, (48, 27), threads=1, reference_samples=64
)
NUM_IMAGES = 2 * 8 + 2 * 2


@pytest.fixture(autouse=True)
def no_report(monkeypatch):
    monkeypatch.setattr(experiment, "write_report", lambda *_: "")
    logging.getLogger("distributed").setLevel(logging.CRITICAL)  # of workers that are killed


def save_shop(folder, paths):
    """A cube with a textured face, in a file beside a folder with its image."""
    command = [sys.executable, "-c", SAVE_SHOP, str(folder), paths]
    subprocess.run(command, check=True, capture_output=True)
    return folder / "shop.blend"


@pytest.fixture(scope="module")
def shop(tmp_path_factory):
    return save_shop(tmp_path_factory.mktemp("shop"), "relative")


@contextmanager
def serving_part(folder, *arguments):
    """A part of a cluster as a process of its own: (the process, the address that it prints)."""
    folder.mkdir(parents=True)
    command = [sys.executable, "-m", "lighttree_batch", *arguments]
    with open(folder / "log.txt", "w") as log:
        process = subprocess.Popen(
            command, cwd=folder, stdout=subprocess.PIPE, stderr=log, text=True
        )
    try:
        yield process, process.stdout.readline().strip()
    finally:
        process.send_signal(signal.SIGINT)
        assert process.wait(30) == 0, (folder / "log.txt").read_text()
        process.stdout.close()


@contextmanager
def running_cluster(folder, *tls, workers=2):
    """A scheduler and its workers: (its address, the processes)."""
    with ExitStack() as stack:
        scheduler, address = stack.enter_context(
            serving_part(folder / "scheduler", "scheduler", "--port", "0", *tls)
        )
        parts = [
            stack.enter_context(serving_part(folder / f"worker-{k}", "worker", address, *tls))
            for k in range(workers)
        ]
        yield address, [scheduler, *(process for process, _ in parts)]


@pytest.fixture(scope="module")
def cluster(tmp_path_factory):
    with running_cluster(tmp_path_factory.mktemp("cluster")) as found:
        yield found


def make_crew(address, tell=print):
    security, address, _ = serving.reach(address, None, None, None, False)
    return ClusterCrew(address, security, 1, tell)


def is_rendering(text):
    return "Rendering" in text or "Sample" in text


@pytest.mark.blender
def test_a_cluster_whose_worker_is_killed_makes_the_images_of_one_process(shop, cluster, tmp_path):
    alone = run_batch([Source(shop)], tmp_path / "alone", OPTIONS)
    assert (alone.num_rendered, alone.failed) == (NUM_IMAGES, [])

    crew, killed = make_crew(cluster[0]), []

    def kill(fraction, text):
        rendering = [worker for worker in crew.workers.values() if is_rendering(worker.heard[1])]
        if "2048spp" in text and rendering and not killed:
            address = rendering[0].address
            killed.append(psutil.Process(crew.client.run(os.getpid, workers=[address])[address]))
            for process in [*killed[0].children(), *killed]:
                process.kill()

    outcome = run_batch([Source(shop)], tmp_path / "many", OPTIONS, kill, cluster=crew)
    assert killed and (outcome.num_rendered, outcome.failed) == (NUM_IMAGES, [])
    assert_same_images(tmp_path / "alone", tmp_path / "many")
    _, header = read_exr(tmp_path / "many/shop/cycles-16spp-seed1.exr")
    assert header["machine"] == describe_machine()


@pytest.mark.blender
@pytest.mark.skipif(not Path("/proc/self/cwd").exists(), reason="hides a file by /proc")
def test_a_scene_that_workers_do_not_see_is_sent(shop, cluster, tmp_path, monkeypatch):
    hidden = Path("/proc/self/cwd/shop.blend")  # another file for every process
    few = Options(("lighttree",), "samples", (16,), 1, (48, 27), threads=1, references=())
    monkeypatch.chdir(shop.parent)
    alone = run_batch([Source(hidden)], tmp_path / "alone", few)
    sent = run_batch([Source(hidden)], tmp_path / "sent", few, cluster=make_crew(cluster[0]))
    assert (alone.num_rendered, sent.num_rendered, sent.failed) == (1, 1, [])
    assert_same_images(tmp_path / "alone", tmp_path / "sent")
    channels, _ = read_exr(tmp_path / "sent/shop/lighttree-16spp-seed1.exr")
    assert channels["R"].max() > 2 * channels["B"].max(), "its texture was not found"

    (tmp_path / "fixed").mkdir()
    save_shop(tmp_path / "fixed", "absolute")
    monkeypatch.chdir(tmp_path / "fixed")
    fixed = run_batch([Source(hidden)], tmp_path / "no", few, cluster=make_crew(cluster[0]))
    (sentence,) = fixed.failed
    assert "signs/sign.png by an absolute path, so it cannot be sent" in sentence


@pytest.mark.blender
def test_ctrl_c_and_a_killed_batch_leave_workers_free(shop, cluster, tmp_path):
    endless = Options(("lighttree",), "seconds", (1000,), 1, (48, 27), threads=1, references=())

    def interrupt(fraction, text):
        if is_rendering(text):
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run_batch([Source(shop)], tmp_path, endless, interrupt, cluster=make_crew(cluster[0]))

    shutil.copy(shop, tmp_path)
    job = 'methods = ["lighttree"]\nseconds = [1000]\nseeds = 1\nthreads = 1\n[[scene]]\n'
    (tmp_path / "jobs.toml").write_text(f'{job}files = ["{shop}"]\n')
    command = [sys.executable, "-m", "lighttree_batch", "batch", str(tmp_path / "jobs.toml")]
    killed = subprocess.Popen([*command, "--scheduler", cluster[0]])
    wait_until(lambda: is_at_work(cluster))
    os.kill(killed.pid, signal.SIGKILL)
    killed.wait()

    few = Options(("lighttree",), "samples", (16,), 1, (48, 27), threads=1, references=())
    outcome = run_batch([Source(shop)], tmp_path / "next", few, cluster=make_crew(cluster[0]))
    assert outcome.num_rendered == 1
    wait_until(lambda: not is_at_work(cluster))


def is_at_work(cluster):
    """Whether a worker renders, for somebody or nobody."""
    with Client(cluster[0], set_as_default=False) as client:
        executing = client.run(lambda dask_worker: len(dask_worker.state.executing))
    return any(executing.values())


def wait_until(holds):
    started = time.monotonic()
    while not holds():
        assert time.monotonic() - started < 60
        time.sleep(0.1)


def test_all_parts_listen_on_loopback_alone(cluster):
    parts = [psutil.Process(part.pid) for part in cluster[1]]
    parts += [child for part in parts for child in part.children(recursive=True)]
    connections = [connection for part in parts for connection in part.net_connections()]
    listening = [c.laddr.ip for c in connections if c.status == "LISTEN"]
    assert len(listening) >= 6 and set(listening) == {"127.0.0.1"}


def test_a_port_that_is_taken_is_told(cluster):
    port = cluster[0].rpartition(":")[2]
    command = [sys.executable, "-m", "lighttree_batch", "scheduler", "--port", port]
    second = subprocess.run(command, capture_output=True, text=True)
    assert second.returncode == 2
    assert f"127.0.0.1:{port}: nothing can listen there (" in second.stderr


def test_workers_that_would_render_something_else_are_left_out():
    told, ours = [], {"machine": "m", "renderers": describe_renderers(), **describe_machine()}

    class Client:
        def run(self, function, workers):
            (address,) = workers
            if address == "none":
                raise ModuleNotFoundError("No module named 'lighttree_batch'")
            old = {"renderers": {"CYCLES": "Blender 3", "LIGHTTREE": "LightTree 0"}}
            return {address: ours | {"good": {}, "old": old, "small": {"cores": 1}}[address]}

    crew = make_crew("localhost:1", told.append)
    crew.num_threads, crew.client = 2, Client()
    met = [crew._meet(address) for address in ("good", "old", "small", "none")]
    assert met[0].cpu == ours["cpu"] and met[1:] == [None] * 3
    assert "old is left out: it renders with Blender 3 and LightTree 0, not with" in told[0]
    assert told[1].startswith("small is left out: it has 1 cores, and renders use 2 threads")
    assert "none is left out: no LightTree answers there (No module named" in told[2]


@pytest.mark.blender
def test_without_a_scheduler_or_workers_a_batch_says_so(shop, tmp_path, monkeypatch):
    monkeypatch.setattr("lighttree_batch.cluster.CONNECT_S", 0.5)
    monkeypatch.setattr(ClusterCrew, "patience_s", 0.5)
    with pytest.raises(InputError, match="no scheduler answers there; start it with"):
        run_batch([Source(shop)], tmp_path, OPTIONS, cluster=make_crew("tcp://127.0.0.1:9"))
    with (
        running_cluster(tmp_path / "idle", workers=0) as (address, _),
        pytest.raises(RenderError, match="No worker is left; start one"),
    ):
        run_batch([Source(shop)], tmp_path, OPTIONS, cluster=make_crew(address))


@pytest.mark.blender
def test_certificates_are_honoured(shop, tmp_path):
    authority, files = trustme.CA(), [tmp_path / name for name in ("ca.pem", "me.pem", "me.key")]
    authority.cert_pem.write_to_path(files[0])
    cert = authority.issue_cert("127.0.0.1")
    cert.cert_chain_pems[0].write_to_path(files[1])
    cert.private_key_pem.write_to_path(files[2])
    names = ("--tls-ca-file", "--tls-cert", "--tls-key")
    options = [str(part) for pair in zip(names, files, strict=True) for part in pair]
    few = Options(("lighttree",), "samples", (16,), 1, (48, 27), threads=1, references=())
    with running_cluster(tmp_path / "tls", *options, workers=1) as (address, (_, worker)):
        assert address.startswith("tls://")
        security, reached, _ = serving.reach(address.replace("tls", "tcp"), *files, False)
        assert reached == address
        crew = ClusterCrew(reached, security, 1, print)
        assert run_batch([Source(shop)], tmp_path / "out", few, cluster=crew).num_rendered == 1
        assert worker.stdout.readline().endswith(" shop lighttree seed 1\n")
        with pytest.raises(InputError, match="give the same certificates to all"):
            run_batch([Source(shop)], tmp_path / "no", few, cluster=make_crew(address))


def test_beyond_this_machine_certificates_are_needed(tmp_path, capsys):
    for host in ("10.0.0.1", "render.example", "::", "0.0.0.0", "192.168.0.7"):
        with pytest.raises(InputError, match="is beyond this machine, and whoever reaches"):
            serving.secure(host, None, None, None, False)
    assert not serving.secure("10.0.0.1", None, None, None, True).require_encryption
    assert "whoever reaches 10.0.0.1 can run code" in capsys.readouterr().err
    for host in ("localhost", "127.0.0.1", "127.8.0.1", "::1"):
        assert not serving.secure(host, None, None, None, False).require_encryption
    with pytest.raises(InputError, match="are given together, or none"):
        serving.secure("localhost", tmp_path, None, None, False)
    with pytest.raises(InputError, match=r"x\.pem: no such file"):
        serving.secure("localhost", *[tmp_path / "x.pem"] * 3, False)
    for address in ("tcp://:1", "http://a:1", "a", "tcp://a:b", ""):
        with pytest.raises(InputError, match="is no address of a scheduler; one is"):
            serving.reach(address, None, None, None, False)
