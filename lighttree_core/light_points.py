"""For every kind of light: the radiance it sends, a sampled point on it, and that point's pdf.

Lights are met by scattered rays too, lamps by the shapes of `lamp_shapes.py`, and share the work
with light sampling by multiple importance sampling; `shares_hits` tells which do.
"""

import math

import numpy as np

from .environment import environment_radiance, pdf_environment, sample_environment
from .jit import FAR, HALF, ONE, TWO, ZERO, kernel
from .sampling import (
    pdf_cone,
    pdf_cosine_hemisphere,
    sample_cone,
    sample_cosine_hemisphere,
    sample_disk,
    sample_triangle,
)
from .scene import (
    ALL_RAYS,
    BACKGROUND,
    CAMERA_RAY,
    DISK,
    ELLIPSE,
    NO_CONE,
    POINT,
    RECTANGLE,
    SPHERE,
    SUN,
    TRIANGLE,
)
from .spherical import (
    sample_spherical_rectangle,
    sample_spherical_triangle,
    solid_angle_rectangle,
    solid_angle_triangle,
)
from .vec import dot, frame, from_frame, length, load3, madd, normalize, scale, sub

# A light with (size / distance)^2 above this is sampled by solid angle; below it, uniformly over
# its area: there both densities agree within a few percent, and area stays exact however small.
NEAR_LIGHT_SQ = np.float32(0.05)
SCATTERED_RAYS = ALL_RAYS & ~CAMERA_RAY


@kernel
def is_hittable(lights, i):
    """Whether rays can meet light i: it has an extent."""
    kind = lights.kind[i]
    return kind != POINT and (kind != SUN or lights.radius[i] > ZERO)


@kernel
def shares_hits(lights, i):
    """Whether sampling light i shares its work with scattered rays that meet it.

    Of a light that only some scattered rays see, or that shines through what hides it from rays,
    hits do not add up to what is sampled: then sampling does all the work, with the weight 1, and
    hits count only on rays for which no light is sampled: those of the camera, and of reflection
    and refraction so sharp that they have no density.
    """
    is_seen = lights.visible[i] & SCATTERED_RAYS == SCATTERED_RAYS
    return is_hittable(lights, i) and is_seen and lights.casts_shadow[i]


@kernel
def emission_falloff(lights, i, direction):
    """Share of its radiance along the axis that a light sends along a unit world direction.

    Spots: smoothstep over the blended part of the cone, in the spot's own frame. Area lights: a
    linear fall in the tangent of the angle, to zero at half the spread. Both as in Cycles.
    """
    kind = lights.kind[i]
    if kind in (RECTANGLE, ELLIPSE):
        cos_theta = dot(direction, load3(lights.axis_w, i))
        if cos_theta <= ZERO:
            return ZERO
        tan_theta = math.sqrt(max(ZERO, ONE - cos_theta * cos_theta)) / cos_theta
        return max(ZERO, ONE - tan_theta / lights.tan_spread[i])
    cos_cone = lights.cos_cone[i]
    if cos_cone == NO_CONE:
        return ONE
    x = dot(direction, load3(lights.axis_u, i))
    y = dot(direction, load3(lights.axis_v, i))
    z = dot(direction, load3(lights.axis_w, i))
    above = z / math.sqrt(x * x + y * y + z * z) - cos_cone
    if above <= ZERO:
        return ZERO
    fade = (ONE - cos_cone) * lights.blend[i]
    t = above / fade if above < fade else ONE
    return t * t * (np.float32(3) - TWO * t)


@kernel
def light_radiance(lights, i, wi, distance):
    """Radiance that arrives along -wi from a point of light i; of a POINT and of a sun of angle 0
    the irradiance on a plane that faces it, W/m^2."""
    radiance = load3(lights.radiance, i)
    kind = lights.kind[i]
    if kind == BACKGROUND:
        return environment_radiance(lights.environment, wi)
    if kind == SUN:
        return radiance
    falloff = emission_falloff(lights, i, scale(wi, -ONE))
    if kind == POINT:
        falloff = falloff / (distance * distance)
    elif kind == TRIANGLE and dot(wi, load3(lights.axis_w, i)) >= ZERO:
        falloff = ZERO
    return scale(radiance, falloff)


@kernel
def is_near(lights, i, p):
    """Whether light i, with flat sides, looks large from p, so its solid angle is sampled."""
    to_light = sub(load3(lights.position, i), p)
    return lights.size_sq[i] > NEAR_LIGHT_SQ * dot(to_light, to_light)


@kernel
def light_corner(lights, i, p):
    """The corner of a rectangle from which its sides start, relative to p."""
    corner = sub(load3(lights.position, i), p)
    corner = madd(corner, -HALF, load3(lights.axis_u, i))
    return madd(corner, -HALF, load3(lights.axis_v, i))


@kernel
def light_solid_angle(lights, i, p):
    """Solid angle (float64) by which a triangle or rectangle is sampled from p; 0 if it is not."""
    if not is_near(lights, i, p):
        return 0.0
    u, v = load3(lights.axis_u, i), load3(lights.axis_v, i)
    if lights.kind[i] == RECTANGLE:
        return solid_angle_rectangle(light_corner(lights, i, p), u, v)
    v0 = sub(load3(lights.position, i), p)
    return solid_angle_triangle(v0, madd(v0, ONE, u), madd(v0, ONE, v))


@kernel
def sample_flat(lights, i, p, u):
    """(vector from p to a point of a triangle, rectangle or ellipse, `light_solid_angle`)."""
    kind = lights.kind[i]
    axis_u, axis_v = load3(lights.axis_u, i), load3(lights.axis_v, i)
    corner = sub(load3(lights.position, i), p)
    if kind == RECTANGLE:
        corner = light_corner(lights, i, p)
    if kind != ELLIPSE and is_near(lights, i, p):
        if kind == RECTANGLE:
            d, omega = sample_spherical_rectangle(corner, axis_u, axis_v, u[0], u[1])
        else:
            v1, v2 = madd(corner, ONE, axis_u), madd(corner, ONE, axis_v)
            omega = solid_angle_triangle(corner, v1, v2)
            d = sample_spherical_triangle(corner, v1, v2, omega, u[0], u[1])
        if omega > 0.0:
            w = load3(lights.axis_w, i)
            t = dot(corner, w) / (d[0] * w[0] + d[1] * w[1] + d[2] * w[2])
            return (np.float32(t * d[0]), np.float32(t * d[1]), np.float32(t * d[2])), omega
    if kind == TRIANGLE:
        s, t = sample_triangle(u)
    elif kind == RECTANGLE:
        s, t = u
    else:
        s, t = sample_disk(u)
        s, t = HALF * s, HALF * t
    return madd(madd(corner, s, axis_u), t, axis_v), 0.0


@kernel
def one_minus_cos(angle):
    """1 - cos(angle), exact for small angles."""
    sin_half = math.sin(HALF * angle)
    return TWO * sin_half * sin_half


@kernel
def sphere_one_minus_cos(radius, dist_sq):
    """1 - cos of half the angle under which a sphere is seen from outside; 2 from inside."""
    sin_sq = radius * radius / dist_sq if dist_sq > ZERO else TWO
    if sin_sq >= ONE:
        return TWO
    return sin_sq / (ONE + math.sqrt(ONE - sin_sq))


@kernel
def sample_sphere(center, radius, u):
    """Unit vector to, and distance of, the visible point of a sphere; center relative to p."""
    dist_sq = dot(center, center)
    w = normalize(center) if dist_sq > ZERO else (ZERO, ZERO, ONE)
    local, height = sample_cone(u, sphere_one_minus_cos(radius, dist_sq))
    fu, fv = frame(w)
    wi = from_frame(fu, fv, w, local)
    # Distance along wi: half the chord from the point nearest to the centre.
    half_chord = math.sqrt(max(ZERO, radius * radius - dist_sq * height * (TWO - height)))
    along = (ONE - height) * math.sqrt(dist_sq)
    return wi, along - half_chord if dist_sq > radius * radius else along + half_chord


@kernel
def is_in_sun(lights, i, direction):
    """Whether a unit direction points into the disc of sun i."""
    # The chord between the two is exact where their cosine is 1 to many digits.
    chord = madd(direction, ONE, load3(lights.axis_w, i))
    return dot(chord, chord) <= TWO * one_minus_cos(lights.radius[i])


@kernel
def sample_background(lights, n, two_sided, u):
    """A unit direction to the background for a surface of normal n, lit from both sides or one."""
    if len(lights.environment.image) > 0:
        return sample_environment(lights.environment, u)[0]
    w = n
    if two_sided:
        side = u[0] >= HALF
        w = scale(n, -ONE) if side else n
        u = (TWO * u[0] - ONE if side else TWO * u[0], u[1])
    fu, fv = frame(w)
    return from_frame(fu, fv, w, sample_cosine_hemisphere(u))


@kernel
def pdf_background(lights, n, two_sided, wi):
    """Density over solid angle with which `sample_background` returns wi."""
    if len(lights.environment.image) > 0:
        return pdf_environment(lights.environment, wi)
    cos_surface = dot(n, wi)
    return pdf_cosine_hemisphere(HALF * abs(cos_surface) if two_sided else cos_surface)


@kernel
def sample_light_point(lights, i, p, n, two_sided, u):
    """A point of light i as seen from p, with normal n: (wi, distance, pdf over solid angle).

    two_sided: whether light from behind the surface counts too. Delta positions and directions have
    the pdf 1. `pdf_light_point` is its twin.
    """
    kind, distance, omega = lights.kind[i], FAR, 0.0
    if kind == BACKGROUND:
        wi = sample_background(lights, n, two_sided, u)
    elif kind == SUN:
        w = scale(load3(lights.axis_w, i), -ONE)
        local, _ = sample_cone(u, one_minus_cos(lights.radius[i]))
        fu, fv = frame(w)
        wi = from_frame(fu, fv, w, local)
    else:
        if kind in (TRIANGLE, RECTANGLE, ELLIPSE):
            to_light, omega = sample_flat(lights, i, p, u)
        else:
            to_light = sub(load3(lights.position, i), p)
            if kind == DISK:
                x, y = sample_disk(u)
                fu, fv = frame(normalize(to_light))
                to_light = madd(to_light, x * lights.radius[i], fu)
                to_light = madd(to_light, y * lights.radius[i], fv)
        if kind == SPHERE:
            wi, distance = sample_sphere(to_light, lights.radius[i], u)
        else:
            wi, distance = normalize(to_light), length(to_light)
    return wi, distance, pdf_for_angle(lights, i, p, n, two_sided, wi, distance, omega)


@kernel
def pdf_light_point(lights, i, p, n, two_sided, wi, distance):
    """Density over solid angle with which `sample_light_point` returns wi; 0 if it cannot."""
    is_flat = lights.kind[i] in (TRIANGLE, RECTANGLE)
    omega = light_solid_angle(lights, i, p) if is_flat else 0.0
    return pdf_for_angle(lights, i, p, n, two_sided, wi, distance, omega)


@kernel
def pdf_for_angle(lights, i, p, n, two_sided, wi, distance, omega):
    """The same where `light_solid_angle`, which takes long, is known already."""
    kind = lights.kind[i]
    if kind == BACKGROUND:
        return pdf_background(lights, n, two_sided, wi)
    if kind == POINT or (kind == SUN and lights.radius[i] == ZERO):
        return ONE
    if kind == SUN:
        return pdf_cone(one_minus_cos(lights.radius[i]))
    to_center = sub(load3(lights.position, i), p)
    if kind == SPHERE:
        return pdf_cone(sphere_one_minus_cos(lights.radius[i], dot(to_center, to_center)))
    if kind == DISK:
        cos_light = dot(wi, normalize(to_center))
    else:
        cos_light = -dot(wi, load3(lights.axis_w, i))
        if omega > 0.0 and cos_light > ZERO:
            return np.float32(1.0 / omega)
    if cos_light <= ZERO:
        return ZERO
    return distance * distance / (cos_light * lights.area[i])
