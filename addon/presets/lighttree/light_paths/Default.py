import bpy

lighttree = bpy.context.scene.lighttree

lighttree.max_bounces = 4
lighttree.max_passes = 8
