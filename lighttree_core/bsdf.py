"""Surfaces: the one that is modelled so far is Lambertian. Directions are unit, in the world."""

from .jit import INV_PI, kernel
from .sampling import pdf_cosine_hemisphere, sample_cosine_hemisphere
from .vec import dot, frame, from_frame, scale


@kernel
def eval_bsdf(albedo, n, wi):
    """The BSDF times the cosine at the surface, for light from wi."""
    return scale(albedo, pdf_cosine_hemisphere(dot(n, wi)))


@kernel
def sample_bsdf(albedo, n, u):
    """A direction to scatter to: (wi, BSDF x cosine / pdf, pdf over solid angle)."""
    local = sample_cosine_hemisphere(u)
    fu, fv = frame(n)
    return from_frame(fu, fv, n, local), albedo, local[2] * INV_PI


@kernel
def pdf_bsdf(n, wi):
    """Density over solid angle with which `sample_bsdf` returns wi."""
    return pdf_cosine_hemisphere(dot(n, wi))
