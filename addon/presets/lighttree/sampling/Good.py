import bpy

lighttree = bpy.context.scene.lighttree

lighttree.samples = 64
lighttree.time_limit_s = 0.0
lighttree.split_lights = 2
