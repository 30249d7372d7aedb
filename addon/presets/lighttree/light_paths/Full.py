import bpy

lighttree = bpy.context.scene.lighttree

lighttree.max_bounces = 32
lighttree.max_passes = 32
