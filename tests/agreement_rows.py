"""The table of features that both engines are to render alike, for `test_agreement.py`.

Kernels are compiled once for all scenes that need the same of the renderer. Rows that need nearly
the same stand together in `GROUPS`, each with what has to be added out of sight to make it equal.
"""

from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import bpy
from agreement_materials import (
    BLUE,
    METAL,
    ORANGE,
    WHITE,
    bumpy,
    color_attribute,
    displaced,
    facing,
    fresnel,
    mixed,
    normal_mapped,
    plain,
    ramped,
    spots,
    textured,
)
from agreement_scenes import (
    BEHIND,
    FILL,
    GLOSSY_FLOOR,
    GLOWING,
    IN_VIEW,
    KEY,
    MATT,
    add_all_out_of_sight,
    add_flags_out_of_sight,
    add_glossy_out_of_sight,
    cut_out,
    emitting,
    lamp,
    limit_bounces,
    lit_by,
    see_through_film,
    set_all,
    show,
    smooth,
    striped,
    surface,
    transparent_stack,
    under_sky,
    unseen,
    use_filter,
)
from blender_scenes import radians


class Row(NamedTuple):
    """A feature.

    build: fills an empty file. adjust: sets what a comparison would else set itself. tolerance: by
    how much the mean may be off beside noise, where `reason` states a difference of models.
    has_alpha: whether alpha is compared too.
    """

    name: str
    build: Callable[[], None]
    adjust: Callable[[bpy.types.Scene], None] = lambda scene: None
    has_alpha: bool = False
    tolerance: float = 0.0
    reason: str = ""


DIFFUSE_AND_TRANSPARENT = ("Diffuse", {"Color": ORANGE}), ("Transparent", {"Color": (0.9, 0.9, 1)})
DIFFUSE_AND_GLOSSY = ("Diffuse", {"Color": BLUE}), ("Glossy", {"Color": WHITE, "Roughness": 0.2})
DIFFUSE_AND_EMISSION = ("Diffuse", {"Color": BLUE}), ("Emission", {"Strength": 0.5})
TRANSPARENT_AND_GLOSSY = DIFFUSE_AND_TRANSPARENT[1], DIFFUSE_AND_GLOSSY[1]
SMOOTHER_BUMPS = "caustics of bumps are smoother in Cycles, whose rays widen at rough surfaces"
GREENISH = (0.9, 1.0, 0.9)
SMALL = lamp("POINT"), lamp("SPOT", (1.8, -1.2, 2.2), radians(35, 0, 50), energy=300.0)
CLEAR = {"Base_Color": ORANGE, "Transmission_Weight": 1.0}

# Diffuse surfaces and emission alone: the smallest kernels.
MATT_ROWS = [
    Row("Diffuse", surface("Diffuse", Color=ORANGE)),
    Row("Emission", emitting),
    Row("Constant world, diffuse", under_sky(is_image=False)),
    Row("Orthographic camera", partial(striped, ortho=True)),
    Row("Depth of field, round", partial(striped, focus=4.0)),
    Row("Depth of field, 6 blades", partial(striped, focus=7.0, blades=6)),
    Row("Box filter", striped),
    Row(
        "Blackman-Harris filter",
        striped,
        adjust=use_filter("BLACKMAN_HARRIS", "blackman-harris", 1.5),
    ),
    Row("Gaussian filter", striped, adjust=use_filter("GAUSSIAN", "gaussian", 2.0)),
]

GLOSSY_ROWS = [
    Row("Diffuse, roughness 0.7", surface("Diffuse", Color=ORANGE, Roughness=0.7)),
    *(
        Row(f"Glossy GGX, roughness {x:g}", surface("Glossy", "GGX", Color=ORANGE, Roughness=x))
        for x in (0.0, 0.1, 0.5, 1.0)
    ),
    *(
        Row(
            f"Glossy Multiscatter GGX, roughness {x:g}",
            surface("Glossy", "MULTI_GGX", Color=ORANGE, Roughness=x),
        )
        for x in (0.5, 1.0)
    ),
    Row("Mix of diffuse and glossy", partial(show, partial(mixed, 0.3, *DIFFUSE_AND_GLOSSY))),
    Row("Sum of diffuse and emission", partial(show, partial(mixed, None, *DIFFUSE_AND_EMISSION))),
    Row("Principled", surface("Principled", Base_Color=ORANGE)),
    Row("Principled, smooth plastic", surface("Principled", Base_Color=ORANGE, Roughness=0.05)),
    Row("Principled, metal", surface("Principled", **METAL, Roughness=0.3)),
    Row("Principled, half metal", surface("Principled", Base_Color=ORANGE, Metallic=0.5)),
    Row(
        "Principled, coat",
        surface("Principled", Base_Color=BLUE, Coat_Weight=0.8, Coat_Tint=(1.0, 0.7, 0.5)),
    ),
    Row("Principled, coat on metal", surface("Principled", **METAL, Coat_Weight=1.0)),
    Row("Principled, diffuse roughness", surface("Principled", Diffuse_Roughness=0.8)),
    Row(
        "Principled, specular tint",
        surface("Principled", Base_Color=BLUE, Specular_Tint=ORANGE, Specular_IOR_Level=0.9),
    ),
    Row("Principled metal, specular tint", surface("Principled", **METAL, Specular_Tint=BLUE)),
    Row(
        "Principled, emission",
        surface("Principled", Base_Color=BLUE, Emission_Color=ORANGE, Emission_Strength=1.0),
    ),
]

# Each kind of lamp over a glossy floor, which scattered rays leave to meet it.
LAMP_ROWS = [
    Row("Point light of no size", lit_by(lamp("POINT"))),
    Row("Point light, disk", lit_by(lamp("POINT", shadow_soft_size=0.4, use_soft_falloff=True))),
    Row("Point light, ball", lit_by(lamp("POINT", shadow_soft_size=0.4, use_soft_falloff=False))),
    Row("Spot", lit_by(lamp("SPOT", spot_size=1.2, energy=300.0))),
    Row(
        "Spot, disk",
        lit_by(lamp("SPOT", spot_size=1.2, shadow_soft_size=0.3, use_soft_falloff=True)),
    ),
    Row(
        "Spot, ball",
        lit_by(lamp("SPOT", spot_size=1.2, shadow_soft_size=0.3, use_soft_falloff=False)),
    ),
    Row("Area light, square", lit_by(lamp("AREA", size=0.8))),
    Row("Area light, ellipse", lit_by(lamp("AREA", shape="ELLIPSE", size=1.2, size_y=0.6))),
    Row("Area light, spread 60 degrees", lit_by(lamp("AREA", size=0.8, spread=1.05))),
    Row("Sun of no size", lit_by(lamp("SUN", energy=3.0, angle=0.0))),
    Row("Sun, 20 degrees", lit_by(lamp("SUN", energy=3.0, angle=0.35))),
    Row("All lamps", lit_by(KEY, FILL, BEHIND, lamp("SUN", energy=1.0, angle=0.1))),
    Row("Lamps seen by the camera", lit_by(*IN_VIEW, change=set_all(visible_camera=True))),
    Row(
        "Sun seen by the camera",
        lit_by(
            lamp("SUN", rotation=radians(-85, 0, 5), energy=3.0, angle=0.3),
            change=set_all(visible_camera=True),
        ),
    ),
    Row("Constant world, glossy", under_sky(GLOSSY_FLOOR, is_image=False)),
]

FLAG_ROWS = [
    Row("Lamps unseen by diffuse rays", lit_by(KEY, FILL, change=set_all(visible_diffuse=False))),
    Row("Lamps unseen by glossy rays", lit_by(KEY, FILL, change=set_all(visible_glossy=False))),
    Row("Lamps of no size without shadows", lit_by(*SMALL, change=set_all(data__use_shadow=False))),
    Row("Lamps of no size, 0 bounces", lit_by(*SMALL, change=limit_bounces(0))),
    Row("Lamps of no size, 1 bounce", lit_by(*SMALL, change=limit_bounces(1))),
    Row(
        "Lamps without shadows",
        lit_by(KEY, FILL, change=set_all(data__use_shadow=False)),
        tolerance=0.03,
        reason="scattered rays of Cycles do not reach such lamps through things",
    ),
    Row(
        "Lamps of 1 bounce",
        lit_by(KEY, FILL, change=limit_bounces(1)),
        tolerance=0.05,
        reason="scattered rays of Cycles meet such lamps after any number of bounces",
    ),
]

# Lamps of no size, so that no ray meets what the lamps' shadows tell otherwise.
HIDDEN_ROWS = [
    Row("Matt objects unseen by the camera", unseen("camera", MATT, *SMALL)),
    Row("Matt objects unseen by diffuse rays", unseen("diffuse", MATT, *SMALL)),
    Row("Matt objects unseen by glossy rays", unseen("glossy", MATT, *SMALL)),
    Row("Matt objects without shadow", unseen("shadow", MATT, *SMALL)),
    Row("Glowing objects unseen by the camera", unseen("camera", GLOWING)),
    Row("Glowing objects unseen by diffuse rays", unseen("diffuse", GLOWING)),
    Row("Glowing objects unseen by glossy rays", unseen("glossy", GLOWING)),
]

TRANSMISSION_ROWS = [
    Row("Translucent", surface("Translucent", Color=ORANGE)),
    *(
        Row(
            f"Refraction, roughness {x:g}",
            surface("Refraction", "GGX", 0.1, x > 0.1, Roughness=x, IOR=1.3),
        )
        for x in (0.0, 0.3)
    ),
    *(
        Row(
            f"Glass, roughness {x:g}",
            surface("Glass", "GGX", 0.1, x > 0.1, Color=GREENISH, Roughness=x),
        )
        for x in (0.0, 0.1, 0.3)
    ),
    Row("Glass, Multiscatter GGX", surface("Glass", "MULTI_GGX", 0.1, True, Roughness=0.6)),
    Row(
        "Glass, roughness 0.6, with lamps",
        surface("Glass", "MULTI_GGX", 0.1, Roughness=0.6),
        tolerance=0.03,
        reason="lamps of Cycles shine through rough glass where its own paths never go",
    ),
    Row("Glass, single sheet", surface("Glass", "GGX", Roughness=0.1, IOR=1.3)),
    *(
        Row(
            f"Principled, transmission, roughness {x:g}",
            surface("Principled", None, 0.1, x > 0.1, **CLEAR, Roughness=x),
        )
        for x in (0.0, 0.4)
    ),
    Row(
        "Principled, half transmission",
        surface("Principled", None, 0.1, Base_Color=BLUE, Transmission_Weight=0.5, Roughness=0.1),
    ),
    Row(
        "Floor unseen by transmission rays",
        unseen(
            "transmission", partial(plain, "Glass", Roughness=0.0), names=("Floor",), has_sky=True
        ),
    ),
]

TRANSPARENT_ROWS = [
    Row("Transparent and diffuse", partial(show, partial(mixed, 0.6, *DIFFUSE_AND_TRANSPARENT))),
    Row("Transparent, ten sheets", transparent_stack),
    Row("Principled, alpha 0.5", surface("Principled", Base_Color=ORANGE, Alpha=0.5)),
]

SMOOTH_ROWS = [
    Row("Smooth normals, diffuse", smooth("Diffuse", Color=ORANGE)),
    Row("Smooth normals, glossy", smooth("Glossy", "GGX", Color=ORANGE, Roughness=0.2)),
    Row("Smooth normals, mirror", smooth("Glossy", "GGX", Color=ORANGE, Roughness=0.0)),
    Row("Smooth normals, Principled", smooth("Principled", Base_Color=ORANGE)),
    Row("Smooth normals, glass", smooth("Glass", "GGX", Roughness=0.1)),
]

TEXTURE_ROWS = [
    Row(
        "Image, colour",
        partial(show, lambda: textured("Diffuse", spots(), ("Color", "Color"))),
    ),
    Row(
        "Image, float colour",
        partial(show, lambda: textured("Diffuse", spots(), ("Color", "Color"), is_float=True)),
    ),
    Row(
        "Image with alpha, colour alone",
        partial(show, lambda: textured("Diffuse", spots(channels=4), ("Color", "Color"))),
    ),
    Row(
        "Image, roughness",
        partial(
            show,
            lambda: textured("Glossy", spots(), ("Color", "Roughness"), is_data=True, Color=ORANGE),
        ),
    ),
    Row(
        "Image, colour and alpha",
        partial(
            show,
            lambda: textured(
                "Principled", spots(channels=4), ("Color", "Base Color"), ("Alpha", "Alpha")
            ),
        ),
    ),
    Row(
        "Image, emission",
        partial(
            show,
            lambda: textured(
                "Principled", spots(), ("Color", "Emission Color"), Emission_Strength=2.0
            ),
        ),
    ),
    Row("Image, ramps of it", partial(show, lambda: ramped("Glossy"))),
    Row("Normal map, diffuse", partial(show, lambda: normal_mapped("Diffuse", 1.0, Color=ORANGE))),
    Row(
        "Normal map, glossy",
        partial(show, lambda: normal_mapped("Glossy", 0.5, Color=ORANGE, Roughness=0.2)),
    ),
    Row("Bump, diffuse", partial(show, lambda: bumpy("Diffuse", Color=ORANGE))),
    Row(
        "Bump, glossy",
        partial(show, lambda: bumpy("Glossy", Color=ORANGE, Roughness=0.2)),
        reason=SMOOTHER_BUMPS,
    ),
    Row(
        "Bump, smooth normals",
        partial(show, lambda: bumpy("Principled", Base_Color=ORANGE), is_smooth=True),
    ),
    Row(
        "Displacement as bump",
        partial(show, lambda: displaced("Principled", **METAL)),
        reason=SMOOTHER_BUMPS,
    ),
    Row("Mix by Fresnel", partial(show, partial(mixed, fresnel, *DIFFUSE_AND_GLOSSY))),
    Row(
        "Mix by facing, transparent",
        partial(show, partial(mixed, facing, *TRANSPARENT_AND_GLOSSY), is_smooth=True),
    ),
    Row("Emission by facing", partial(show, partial(mixed, facing, *DIFFUSE_AND_EMISSION))),
    Row("Colour attribute", partial(show, lambda: color_attribute("Diffuse"))),
    Row("Colour attribute, Principled", partial(show, lambda: color_attribute("Principled"))),
]

SKY_ROWS = [
    Row("Environment image, diffuse", under_sky()),
    Row("Environment image, glossy", under_sky(GLOSSY_FLOOR)),
    Row("Environment image, turned", under_sky(GLOSSY_FLOOR, turn_deg=50.0)),
    Row("Environment image, unseen by the camera", under_sky(GLOSSY_FLOOR, backdrop=ORANGE)),
    *(
        Row(f"World seen by {ray} rays alone", under_sky(GLOSSY_FLOOR, visible=(ray,)))
        for ray in ("camera", "diffuse", "glossy")
    ),
]

FILM_ROWS = [Row("Transparent film", cut_out, has_alpha=True)]

GROUPS = (
    (lambda: None, MATT_ROWS),
    (add_glossy_out_of_sight, GLOSSY_ROWS + LAMP_ROWS),
    (
        add_flags_out_of_sight,
        [x._replace(adjust=see_through_film) for x in FILM_ROWS + FLAG_ROWS + HIDDEN_ROWS],
    ),
    (add_flags_out_of_sight, SKY_ROWS),
    (add_all_out_of_sight, TRANSMISSION_ROWS + TRANSPARENT_ROWS + SMOOTH_ROWS + TEXTURE_ROWS),
)


def _both(*functions):
    """A function that calls all of these."""
    return lambda: [function() for function in functions]


ROWS = [row._replace(build=_both(row.build, add)) for add, rows in GROUPS for row in rows]
