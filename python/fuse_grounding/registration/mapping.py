"""A live COLMAP model: the incremental mapper, one view at a time, on a reconstruction kept in memory.

COLMAP's correspondence graph cannot grow once finalised, so every step takes a fresh
`pycolmap.DatabaseCache` and begins a fresh `IncrementalMapper` on the same `Reconstruction`; that
costs milliseconds. Everything runs on one thread with a fixed seed, without which two runs never
give the same bits.
"""

from __future__ import annotations

import copy
import logging
from itertools import product

import numpy as np
import pycolmap

Pose = tuple[np.ndarray, np.ndarray]
"""`(rotation (3, 3), translation (3,))`, map → camera."""

_INIT_ANGLES = (16.0, 8.0, 4.0)
_INIT_INLIERS = (100, 50, 30)
_POSE_INLIERS = (30, 15)
"""COLMAP's default, then what a weakly textured view still reaches."""
_WHOLE_MODEL = -1
"""`INVALID_IMAGE_ID` overflows in `find_initial_image_pair`; −1 means the same."""

logger = logging.getLogger(__name__)


def pipeline_options(seed: int) -> pycolmap.IncrementalPipelineOptions:
    """COLMAP's defaults with fixed intrinsics, one thread and one seed."""
    pycolmap.logging.minloglevel = int(pycolmap.logging.ERROR)
    options = pycolmap.IncrementalPipelineOptions()
    options.ba_refine_focal_length = False
    options.ba_refine_principal_point = False
    options.ba_refine_extra_params = False
    options.ba_refine_sensor_from_rig = False
    options.mapper.abs_pose_refine_focal_length = False
    options.mapper.abs_pose_refine_extra_params = False
    options.num_threads = options.mapper.num_threads = 1
    options.random_seed = options.mapper.random_seed = options.triangulation.random_seed = seed
    return options


class LiveModel:
    """One reconstruction and what is done to it. Image ids are the caller's."""

    def __init__(self, seed: int) -> None:
        self.reconstruction = pycolmap.Reconstruction()
        self._seed = seed
        self._pipeline = pipeline_options(seed)

    def start(self, cache: pycolmap.DatabaseCache, image_ids: list[int]) -> bool:
        """Builds the first model from `image_ids`; some may stay out (`pose` is then None).

        The two-view start asks for COLMAP's 16 degrees and 100 inliers, then for less. False when
        no two views start a model.
        """
        for inliers, angle in product(_INIT_INLIERS, _INIT_ANGLES):
            self.reconstruction = pycolmap.Reconstruction()
            mapper = self._mapper(cache)
            started = self._first_pair(mapper, angle, inliers)
            if started:
                self._rest(mapper, image_ids)
                mapper.end_reconstruction(False)
                return self.reconstruction.num_reg_images() >= 2
            mapper.end_reconstruction(True)
        return False

    def add(self, cache: pycolmap.DatabaseCache, image_id: int, adjust_globally: bool) -> bool:
        """Registers, triangulates, adjusts locally and, if asked, globally. False if it cannot."""
        mapper = self._mapper(cache)
        registered = self._register(mapper, image_id)
        if registered and adjust_globally:
            self._refine_globally(mapper)
        mapper.end_reconstruction(False)
        return registered and self.pose(image_id) is not None

    def fork(self) -> LiveModel:
        """A twin that goes its own way from here."""
        twin = LiveModel(self._seed)
        twin.reconstruction = copy.deepcopy(self.reconstruction)
        return twin

    def pose(self, image_id: int) -> Pose | None:
        """Camera-from-map of a registered image, else None."""
        if not self.reconstruction.exists_image(image_id):
            return None
        image = self.reconstruction.image(image_id)
        if not image.has_pose:
            return None
        matrix = image.cam_from_world().matrix()
        return matrix[:, :3].copy(), matrix[:, 3].copy()

    def _mapper(self, cache: pycolmap.DatabaseCache) -> pycolmap.IncrementalMapper:
        pycolmap.set_random_seed(self._seed)
        mapper = pycolmap.IncrementalMapper(cache)
        mapper.begin_reconstruction(self.reconstruction)
        return mapper

    def _first_pair(self, mapper: pycolmap.IncrementalMapper, angle: float, inliers: int) -> bool:
        options = self._pipeline.get_mapper()
        options.init_min_tri_angle = angle
        options.init_min_num_inliers = inliers
        found = mapper.find_initial_image_pair(options, _WHOLE_MODEL, _WHOLE_MODEL)
        if found is None:
            return False
        (first, second), second_from_first = found
        # By position: pycolmap 3.13 names these arguments wrongly.
        mapper.register_initial_image_pair(options, first, second, second_from_first)
        for image_id in (first, second):
            mapper.triangulate_image(self._pipeline.get_triangulation(), image_id)
        mapper.adjust_global_bundle(options, self._pipeline.get_global_bundle_adjustment())
        mapper.filter_points(options)
        mapper.filter_frames(options)
        return self.reconstruction.num_reg_images() == 2 and self.reconstruction.num_points3D() > 0

    def _rest(self, mapper: pycolmap.IncrementalMapper, image_ids: list[int]) -> None:
        """Registers what is left until nothing more goes in; each success may unlock another."""
        while True:
            left = [i for i in image_ids if self.pose(i) is None]
            added = [i for i in left if self._register(mapper, i)]
            self._refine_globally(mapper)
            if not added:
                return

    def _register(self, mapper: pycolmap.IncrementalMapper, image_id: int) -> bool:
        options = self._pipeline.get_mapper()
        triangulation = self._pipeline.get_triangulation()
        for enough in _POSE_INLIERS:
            options.abs_pose_min_num_inliers = enough
            if mapper.register_next_image(options, image_id):
                break
        else:
            return False
        mapper.triangulate_image(triangulation, image_id)
        mapper.iterative_local_refinement(
            self._pipeline.ba_local_max_refinements,
            self._pipeline.ba_local_max_refinement_change,
            options,
            self._pipeline.get_local_bundle_adjustment(),
            triangulation,
            image_id,
        )
        return True

    def _refine_globally(self, mapper: pycolmap.IncrementalMapper) -> None:
        mapper.iterative_global_refinement(
            self._pipeline.ba_global_max_refinements,
            self._pipeline.ba_global_max_refinement_change,
            self._pipeline.get_mapper(),
            self._pipeline.get_global_bundle_adjustment(),
            self._pipeline.get_triangulation(),
            False,  # Normalising would move the frame under the views that are out already.
        )
