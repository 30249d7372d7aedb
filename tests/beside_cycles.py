"""Render Blender's first scene by one engine after the other, in one process, to FOLDER/N.exr.

python beside_cycles.py -- FOLDER CYCLES LIGHTTREE CYCLES
blender --background --python beside_cycles.py -- FOLDER CYCLES
"""

import os
import sys

import bpy

folder, *engines = sys.argv[sys.argv.index("--") + 1 :]
if "LIGHTTREE" in engines and not hasattr(bpy.types.Scene, "lighttree"):
    import lighttree_addon

    lighttree_addon.register()
scene = bpy.context.scene
scene.render.resolution_x, scene.render.resolution_y = 64, 36
scene.render.image_settings.file_format = "OPEN_EXR"
scene.render.image_settings.color_depth = "32"
for index, engine in enumerate(engines):
    scene.render.engine = engine
    scene.render.filepath = f"{folder}/{index}.exr"
    if engine == "LIGHTTREE":
        scene.lighttree.samples = 4
    else:
        scene.cycles.samples, scene.cycles.use_denoising = 4, False
    bpy.ops.render.render(write_still=True)
os._exit(0)  # Blender 4.5 may hang when Python ends
