"""`blender FILE.blend --command lighttree ...`: the command line of lighttree_batch in Blender."""

import bpy

_registered = None


def run(argv: list[str]) -> int:
    """Run one command, on the open file if none is named; returns its exit code."""
    from lighttree_batch.__main__ import main

    return main(argv)


def register():
    global _registered
    _registered = bpy.utils.register_cli_command("lighttree", run)


def unregister():
    bpy.utils.unregister_cli_command(_registered)
