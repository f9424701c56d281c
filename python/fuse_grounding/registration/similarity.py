"""The similarity that takes a reconstruction's own frame to the world, fitted from known poses.

Camera centres of a few neighbouring views lie nearly on a line, and a fit to centres alone is then
free to turn about that line (in the worst case by 180 degrees). The orientations have no such
freedom, so they alone fix the rotation; scale and translation follow from the centres.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

_COINCIDENT = 1e-20
"""Squared spread over squared distance from the origin below which centres differ by rounding alone."""


@dataclass(frozen=True)
class Similarity:
    """`x_world = scale * rotation @ x_map + translation`; float64, rotation (3, 3), translation (3,)."""

    scale: float
    rotation: np.ndarray
    translation: np.ndarray

    def points(self, xyz: np.ndarray) -> np.ndarray:
        """Points (N, 3) of the map, in the world."""
        return self.scale * xyz @ self.rotation.T + self.translation

    def pose(self, rotation: np.ndarray, translation: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The pose camera-from-world, in metres, of a camera given as camera-from-map.

        With x_camera = R x_map + t, scaling the camera's frame along gives
        R' = R rotationᵀ and t' = scale t − R' translation.
        """
        turned = rotation @ self.rotation.T
        return turned, self.scale * translation - turned @ self.translation


def project_to_rotation(matrix: np.ndarray) -> np.ndarray:
    """The rotation nearest to `matrix` (3, 3) in the Frobenius norm; always of determinant 1."""
    u, _, vt = np.linalg.svd(matrix)
    return u @ np.diag([1.0, 1.0, np.sign(np.linalg.det(u @ vt))]) @ vt


def fit_similarity(
    map_poses: list[tuple[np.ndarray, np.ndarray]], world_poses: list[tuple[np.ndarray, np.ndarray]]
) -> Similarity:
    """World-from-map from the same cameras in both frames, each pose `(R, t)` frame → camera.

    rotation = chordal mean over cameras of R_worldᵀ R_map; scale = Σ ⟨c_world, rotation c_map⟩ / Σ |c_map|²
    over centred camera centres; translation from the two mean centres. Raises ValueError for fewer than
    two cameras and when the centres of either frame coincide or disagree so much that no positive scale
    fits them.
    """
    if len(map_poses) != len(world_poses) or len(map_poses) < 2:
        raise ValueError(f"a similarity needs two or more pairs of poses, found {len(map_poses)}")
    rotation = project_to_rotation(
        np.sum([rw.T @ rm for (rm, _), (rw, _) in zip(map_poses, world_poses, strict=True)], axis=0)
    )
    map_centres = np.array([-r.T @ t for r, t in map_poses])
    world_centres = np.array([-r.T @ t for r, t in world_poses])
    map_mean, world_mean = map_centres.mean(axis=0), world_centres.mean(axis=0)
    turned = (map_centres - map_mean) @ rotation.T
    spread = float(np.sum(turned**2))
    agreement = float(np.sum((world_centres - world_mean) * turned))
    rounding = _COINCIDENT * float(np.sum(map_centres**2))
    if not (np.isfinite(agreement) and spread > rounding and agreement > 0.0):
        raise ValueError("the camera centres fix no positive scale between the two frames")
    scale = agreement / spread
    return Similarity(scale, rotation, world_mean - scale * rotation @ map_mean)
