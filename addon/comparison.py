"""A comparison with Cycles: its settings, the copy of the file it is made of, and its process.

The process is a worker of lighttree_batch, so that Blender stays usable and all that is open stays
as it is: the file, its settings, and whether it counts as changed. A thread waits for it.
"""

from __future__ import annotations

import errno
import logging
import shutil
import threading
from pathlib import Path

import bpy
from bpy.props import BoolProperty, FloatProperty, IntProperty, StringProperty

log = logging.getLogger(__name__)

FOLDER = "//lighttree-compare"
COPY = ".copy"  # the folder of the copy, in the folder of the results
STARTUP_S = 15  # of the processes, about
REFERENCES = 2 * 10  # what errors are measured against takes as long as so many renders
LEAST_SIDE_PX = 4
VIEW_SETTINGS = (
    "view_transform",
    "look",
    "exposure",
    "gamma",
    "use_white_balance",
    "white_balance_temperature",
    "white_balance_tint",
)


class CompareError(RuntimeError):
    """Why there can be no comparison, in one sentence."""


class _Stopped(Exception):
    """Somebody wants no more of it."""


class LightTreeCompareSettings(bpy.types.PropertyGroup):
    """`scene.lighttree_compare`."""

    seconds: FloatProperty(
        name="Time",
        description="Seconds of rendering for each engine; the references that their errors are "
        "measured against take twenty times as long",
        default=4,
        min=0.01,
        soft_max=60,
        max=1e5,
        subtype="TIME_ABSOLUTE",
        unit="TIME_ABSOLUTE",
    )
    percentage: IntProperty(
        name="Resolution",
        description="Percentage of the scene's resolution",
        default=25,
        min=1,
        max=100,
        subtype="PERCENTAGE",
    )
    no_lamp_mis: BoolProperty(
        name="No Lamp MIS",
        description="Also render with Cycles whose scattered rays do not look for lamps, often "
        "its better setting where lamps are many",
        default=False,
    )
    folder: StringProperty(
        name="Output",
        description="Folder for the images and the report. While the file is unsaved it is a "
        "temporary one, which is gone when Blender closes",
        default=FOLDER,
        subtype="DIR_PATH",
        options={"PATH_SUPPORTS_BLEND_RELATIVE"},
    )


class Comparison:
    """How far a comparison is, and what it came to.

    result: of `compare_scene` in `batch/side_by_side.py`. error: a sentence, if it went wrong.
    """

    def __init__(self, scene_name: str, job: dict | None = None, error: str = ""):
        self.scene_name, self.error = scene_name, error
        self.fraction, self.text = 0.0, "Starting Blender"
        self.result: dict | None = None
        self._job = job
        self._is_stopped = False
        self._thread = threading.Thread(target=self.run, daemon=True)

    def start(self) -> None:
        """Run in a thread."""
        self._thread.start()

    @property
    def is_running(self) -> bool:
        return self._thread.is_alive()

    def stop(self) -> None:
        """Have its processes ended, in half a second; Blender goes on meanwhile."""
        self._is_stopped = True

    def end(self) -> None:
        """Stop, and wait until they have."""
        self.stop()
        if self.is_running:
            self._thread.join()

    def run(self) -> None:
        """Compare until there is a result, an error, or somebody stops it."""
        try:
            # All that Blender's own process takes from the batch tool: it knows its workers.
            from lighttree_batch.process import RenderProcess

            log_path = Path(bpy.app.tempdir, "lighttree-compare.txt")
            with RenderProcess(log_path) as process:
                self.result = process.ask(self._job, self._advance)
        except _Stopped:
            pass
        except Exception as error:
            self.error = _explain(error, self._job["file"])
        finally:
            shutil.rmtree(Path(self._job["file"]).parent, ignore_errors=True)

    def _advance(self, fraction: float, text: str) -> None:
        if self._is_stopped:
            raise _Stopped
        self.fraction, self.text = fraction, text


def prepare(context) -> Comparison:
    """A comparison, ready to run, of what the window shows; CompareError if there can be none."""
    scene = context.scene
    if scene.camera is None:
        raise CompareError("The scene has no active camera; set one.")
    folder = output_folder(scene)
    # In there, for from another drive relative paths would lead nowhere.
    file = folder / COPY / f"{Path(bpy.data.filepath).stem or 'untitled'}.blend"
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        file.unlink(missing_ok=True)  # Blender would keep it, as a backup
        _save_copy(file)
    except (OSError, RuntimeError) as error:
        shutil.rmtree(file.parent, ignore_errors=True)
        reason = error.strerror if isinstance(error, OSError) else str(error).strip()
        sentence = f"{folder}: no results can be written there ({reason})."
        raise CompareError(sentence) from error
    job = {"do": "compare", "file": str(file), "out": str(folder), "options": options(scene)}
    job["view"] = {name: getattr(scene.view_settings, name) for name in VIEW_SETTINGS}
    # Who opens a file without its windows gets the scene of the first one.
    windows = context.window_manager.windows
    usual = (windows[0].scene, scene.view_layers[0]) if windows else None
    if (scene, context.view_layer) != usual:
        job["shown"] = {"scene": scene.name, "view_layer": context.view_layer.name}
    return Comparison(scene.name, job)


def options(scene: bpy.types.Scene) -> dict:
    """`Options` of `batch/plan.py`; what the scene does not tell is as in every comparison."""
    settings, render = scene.lighttree_compare, scene.render
    sides = render.resolution_x, render.resolution_y
    return {
        "methods": ["lighttree", "cycles"] + settings.no_lamp_mis * ["cycles-no-lamp-mis"],
        "budgets": [round(settings.seconds, 3)],
        "seeds": 1,
        "resolution": [max(LEAST_SIDE_PX, round(n * settings.percentage / 100)) for n in sides],
        "bounces": scene.lighttree.max_bounces,
        "threads": render.threads if render.threads_mode == "FIXED" else 0,
    }


def output_folder(scene: bpy.types.Scene) -> Path:
    """Where results go."""
    folder = scene.lighttree_compare.folder or FOLDER
    if folder.startswith("//") and not bpy.data.filepath:
        return Path(bpy.app.tempdir, folder.lstrip("/"))
    return Path(bpy.path.abspath(folder)).absolute()


def estimate_s(scene: bpy.types.Scene) -> float:
    """About how many seconds a comparison takes."""
    chosen = options(scene)
    return (len(chosen["methods"]) + REFERENCES) * chosen["budgets"][0] + STARTUP_S


def _save_copy(file: Path) -> None:
    """Save what is open, as it is now; its relative paths are made to lead where they did."""
    packs, bpy.data.use_autopack = bpy.data.use_autopack, False  # it would pack the original
    try:
        bpy.ops.wm.save_as_mainfile(
            filepath=str(file), check_existing=False, copy=True, relative_remap=True
        )
    finally:
        bpy.data.use_autopack = packs


def _explain(error: Exception, file: str) -> str:
    """One sentence for the user, who does not know of the copy."""
    if isinstance(error, ImportError):
        return f"This needs all of LightTree; install it anew ({error})."
    if isinstance(error, OSError) and error.errno == errno.ENOSPC:
        return "The disk is full; make room and compare again."
    if isinstance(error, OSError) and error.filename:
        return f"{error.filename}: {error.strerror}."
    if type(error).__module__.startswith("lighttree_"):  # they tell all there is to tell
        text = str(error).removeprefix(f"{file}: ").replace(file, Path(file).name)
        return text[:1].upper() + text[1:]
    log.error("The comparison failed", exc_info=error)
    return f"The comparison failed: {error}. The console tells where."
