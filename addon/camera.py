"""Blender's camera and frame -> Camera."""

from __future__ import annotations

import numpy as np

from lighttree_core.scene import Camera, SceneError


def extract_camera(depsgraph) -> Camera:
    """The camera of the scene, with the frame that its render settings give it."""
    scene = depsgraph.scene_eval
    if scene.camera is None:
        raise SceneError(
            "The scene has no camera: add one (Shift A > Camera) or set it under Scene properties."
        )
    camera = scene.camera.evaluated_get(depsgraph)
    if camera.type != "CAMERA" or camera.data.type not in ("PERSP", "ORTHO"):
        kind = camera.data.type if camera.type == "CAMERA" else camera.type
        raise SceneError(
            f"Camera {camera.name} is of type {kind}, which LightTree does not render: "
            "set its lens to Perspective or Orthographic."
        )

    render, lens = scene.render, camera.data
    percent = render.resolution_percentage
    width = max(1, render.resolution_x * percent // 100)
    height = max(1, render.resolution_y * percent // 100)
    half, half_width, half_height = _half_sizes(lens, render, width, height)
    return Camera(
        world_from_camera=np.array(camera.matrix_world.normalized(), np.float64)[:3],
        half_width=half_width,
        half_height=half_height,
        width_px=width,
        height_px=height,
        shift_x=2 * lens.shift_x * half,
        shift_y=2 * lens.shift_y * half,
        orthographic=lens.type == "ORTHO",
        clip_start=lens.clip_start,
        clip_end=lens.clip_end,
        crop_px=_crop(render, width, height),
        **_lens(camera),
    )


def view_camera(region, view, depsgraph) -> Camera:
    """What a 3D view looks through; region, view: its Region and RegionView3D.

    OpenGL's projection, which Blender keeps with each view, tells all but depth of field.
    """
    matrix = np.array(view.window_matrix, np.float64)
    half_width, half_height = 1 / matrix[0, 0], 1 / matrix[1, 1]
    is_perspective = view.is_perspective
    shift = matrix[:2, 2] if is_perspective else -matrix[:2, 3]
    # Depths whose projections are -1 and 1; an orthographic view looks behind itself too.
    if is_perspective:
        near, far = matrix[2, 3] / (matrix[2, 2] - 1), matrix[2, 3] / (matrix[2, 2] + 1)
    else:
        near, far = (matrix[2, 3] + 1) / matrix[2, 2], (matrix[2, 3] - 1) / matrix[2, 2]
    camera = depsgraph.scene_eval.camera
    sees_through = view.view_perspective == "CAMERA" and camera and camera.type == "CAMERA"
    return Camera(
        world_from_camera=np.array(view.view_matrix.inverted().normalized(), np.float64)[:3],
        half_width=half_width,
        half_height=half_height,
        width_px=region.width,
        height_px=region.height,
        shift_x=shift[0] * half_width,
        shift_y=shift[1] * half_height,
        orthographic=not is_perspective,
        clip_start=near,
        clip_end=far,
        **(_lens(camera.evaluated_get(depsgraph)) if sees_through else {}),
    )


def _half_sizes(lens, render, width, height):
    """Half the sensor as projected, then half the width and half the height of the frame.

    At distance 1, or in metres if orthographic. As in Blender's source/blender/blenkernel/intern/
    camera.cc; test_camera.py compares with `calc_matrix_camera`.
    """
    aspect_width = width * render.pixel_aspect_x
    aspect_height = height * render.pixel_aspect_y
    fit = lens.sensor_fit
    horizontal = fit == "HORIZONTAL" or (fit == "AUTO" and aspect_width >= aspect_height)
    sensor = lens.sensor_height if fit == "VERTICAL" else lens.sensor_width
    half = lens.ortho_scale / 2 if lens.type == "ORTHO" else sensor / (2 * lens.lens)
    if horizontal:
        return half, half, half * aspect_height / aspect_width
    return half, half * aspect_width / aspect_height, half


def _lens(camera):
    """The fields of Camera that make depth of field, none if it is off.

    The radius of the aperture, in metres, as in Cycles' blender/camera.cpp: an orthographic camera
    is taken for one of 1 m focal length.
    """
    lens, dof = camera.data, camera.data.dof
    if not dof.use_dof:
        return {}
    focal_length = 1.0 if lens.type == "ORTHO" else lens.lens * 1e-3
    return {
        "lens_radius": focal_length / (2 * max(dof.aperture_fstop, 1e-5)),
        "focus_distance": _focus_distance(camera),
        "num_blades": dof.aperture_blades,
        "blade_rotation": dof.aperture_rotation,
        "lens_ratio": dof.aperture_ratio,
    }


def _focus_distance(camera):
    """Metres along the viewing axis to what is in focus: an object, a bone of it, or as set."""
    dof = camera.data.dof
    focus = dof.focus_object
    if focus is None:
        return dof.focus_distance
    place = focus.matrix_world
    bone = focus.pose and focus.pose.bones.get(dof.focus_subtarget)
    if bone:
        place = place @ bone.matrix
    axis = camera.matrix_world.normalized().col[2].xyz
    return abs(axis.dot(camera.matrix_world.translation - place.translation))


def _crop(render, width, height):
    """(x0, y0, x1, y1) pixels to render: the border if there is one, else the frame."""
    if not render.use_border:
        return 0, 0, width, height
    sides = ((render.border_min_x, width), (render.border_min_y, height))
    sides += ((render.border_max_x, width), (render.border_max_y, height))
    # Blender multiplies in float32.
    x0, y0, x1, y1 = (int(np.float32(share) * np.float32(size)) for share, size in sides)
    if x0 >= x1 or y0 >= y1:
        raise SceneError(
            f"The render border is {x1 - x0} x {y1 - y0} pixels: draw a larger one (Ctrl B in the "
            "camera view) or remove it (Ctrl Alt B)."
        )
    return x0, y0, x1, y1
