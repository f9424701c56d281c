"""Where the matches between views come from: memory (profile "fast") or a database (profile "paper").

Both number images from 1 in order of arrival and hand COLMAP's mapper a `pycolmap.DatabaseCache`.
"""

from __future__ import annotations

import copy
import tempfile
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Protocol

import cv2
import numpy as np
import pycolmap

from fuse_grounding._core import Camera
from fuse_grounding.environment.protocol import Observation
from fuse_grounding.errors import FuseError, InputError
from fuse_grounding.registration import features

_NO_PIXELS = np.zeros((0, 0, 3), np.uint8)


class Correspondences(Protocol):
    """Verified matches among the views so far."""

    def add_seeds(self, views: Sequence[Observation]) -> list[int]:
        """Takes the seed views and matches all pairs; their image ids."""
        ...

    def add(self, view: Observation) -> int:
        """Takes a view and matches it with some earlier ones; its image id."""
        ...

    def keypoints(self, image_id: int) -> np.ndarray:
        """(N, 2) pixels of the image's features."""
        ...

    def cache(self) -> pycolmap.DatabaseCache:
        """Images and matches as COLMAP's mapper reads them."""
        ...

    def fork(self) -> Correspondences:
        """A twin that goes its own way from here. Raises InputError where that cannot be."""
        ...


def colmap_camera(camera: Camera) -> pycolmap.Camera:
    """The intrinsics as COLMAP's PINHOLE camera 1, trusted as they are."""
    made = pycolmap.Camera(
        camera_id=1,
        model="PINHOLE",
        width=camera.width,
        height=camera.height,
        params=[camera.fx, camera.fy, camera.cx, camera.cy],
    )
    made.has_prior_focal_length = True
    return made


def _verification(seed: int) -> pycolmap.TwoViewGeometryOptions:
    options = pycolmap.TwoViewGeometryOptions()
    options.ransac.random_seed = seed
    return options


class MemoryCorrespondences:
    """OpenCV features, matched with the nearest views and kept in dictionaries."""

    def __init__(
        self, camera: Camera, neighbours: int, max_features: int, contrast: float, seed: int
    ) -> None:
        self._camera = colmap_camera(camera)
        self._rig = pycolmap.Rig(rig_id=1)
        self._rig.add_ref_sensor(self._camera.sensor_id)
        self._neighbours = neighbours
        self._max_features = max_features
        self._contrast = contrast
        self._verification = _verification(seed)
        self._views: list[Observation] = []
        self._features: list[features.Features] = []
        self._inliers: dict[tuple[int, int], np.ndarray] = {}

    def add_seeds(self, views: Sequence[Observation]) -> list[int]:
        """Takes the seed views and matches all pairs."""
        return [self._take(view, len(views)) for view in views]

    def add(self, view: Observation) -> int:
        """Takes a view and matches it with its nearest."""
        return self._take(view, self._neighbours)

    def keypoints(self, image_id: int) -> np.ndarray:
        """(N, 2) pixels of the image's features."""
        return self._features[image_id - 1].keypoints

    def cache(self) -> pycolmap.DatabaseCache:
        """A fresh cache; an image without features is in it too and simply never registers."""
        cache = pycolmap.DatabaseCache()
        cache.add_camera(self._camera)
        cache.add_rig(self._rig)
        for image_id, found in enumerate(self._features, start=1):
            image = pycolmap.Image(
                name=f"{image_id:06d}", keypoints=found.keypoints, camera_id=1, image_id=image_id
            )
            frame = pycolmap.Frame(frame_id=image_id, rig_id=1)
            frame.add_data_id(image.data_id)
            image.frame_id = image_id
            cache.add_frame(frame)
            cache.add_image(image)
        graph = cache.correspondence_graph
        for (first, second), pairs in self._inliers.items():
            graph.add_correspondences(first, second, pairs)
        graph.finalize()
        return cache

    def fork(self) -> MemoryCorrespondences:
        """A twin that goes its own way from here; it shares what never changes."""
        twin = copy.copy(self)
        twin._views, twin._features = list(self._views), list(self._features)
        twin._inliers = dict(self._inliers)
        return twin

    def _take(self, view: Observation, neighbours: int) -> int:
        found = features.extract(view.rgb, self._max_features, self._contrast)
        image_id = len(self._features) + 1
        for earlier in features.nearest_views(view, self._views, neighbours):
            pairs = self._verified(self._features[earlier], found)
            if pairs is not None:
                self._inliers[earlier + 1, image_id] = pairs
        self._features.append(found)
        self._views.append(replace(view, rgb=_NO_PIXELS, depth=None, instance=None))
        return image_id

    def _verified(self, first: features.Features, second: features.Features) -> np.ndarray | None:
        pairs = features.match(first, second)
        if len(pairs) < self._verification.min_num_inliers:
            return None
        geometry = pycolmap.estimate_calibrated_two_view_geometry(
            self._camera, first.keypoints, self._camera, second.keypoints, pairs, self._verification
        )
        inliers = np.asarray(geometry.inlier_matches, np.uint32)
        return inliers if len(inliers) >= self._verification.min_num_inliers else None


class DatabaseCorrespondences:
    """The supplement's way: a COLMAP database, its own SIFT, guided sequential matching.

    Seeds are matched exhaustively with COLMAP's defaults; each later view sequentially with the
    last `overlap`, guided, at most 32768 matches, ratio 0.9, distance 0.8. The database and the
    pictures live in a temporary folder that goes with this object.
    """

    def __init__(self, camera: Camera, overlap: int, seed: int) -> None:
        self._folder = tempfile.TemporaryDirectory(prefix="fuse-colmap-")
        self._database_path = Path(self._folder.name) / "database.db"
        self._pairing = pycolmap.SequentialPairingOptions(overlap=overlap, num_threads=1)
        self._verification = _verification(seed)
        with pycolmap.Database.open(str(self._database_path)) as database:
            database.write_camera(colmap_camera(camera), use_camera_id=True)
        self._ids: list[int] = []

    def add_seeds(self, views: Sequence[Observation]) -> list[int]:
        """Takes the seed views and matches all pairs."""
        ids = [self._extract(view) for view in views]
        pycolmap.match_exhaustive(
            str(self._database_path),
            matching_options=pycolmap.FeatureMatchingOptions(num_threads=1),
            verification_options=self._verification,
            device=pycolmap.Device.cpu,
        )
        return ids

    def add(self, view: Observation) -> int:
        """Takes a view and matches it with the most recent ones."""
        image_id = self._extract(view)
        matching = pycolmap.FeatureMatchingOptions(num_threads=1, guided_matching=True, max_num_matches=32768)
        matching.sift.max_ratio = features.RATIO
        matching.sift.max_distance = features.MAX_ANGLE
        pycolmap.match_sequential(
            str(self._database_path),
            matching_options=matching,
            pairing_options=self._pairing,
            verification_options=self._verification,
            device=pycolmap.Device.cpu,
        )
        return image_id

    def keypoints(self, image_id: int) -> np.ndarray:
        """(N, 2) pixels of the image's features."""
        with pycolmap.Database.open(str(self._database_path)) as database:
            return np.asarray(database.read_keypoints(image_id), np.float64)[:, :2]

    def cache(self) -> pycolmap.DatabaseCache:
        """What the database holds, pairs of fewer than COLMAP's 15 matches left out."""
        with pycolmap.Database.open(str(self._database_path)) as database:
            return pycolmap.DatabaseCache.create(
                database, pycolmap.IncrementalPipelineOptions().min_num_matches, False, set()
            )

    def fork(self) -> DatabaseCorrespondences:
        """Raises InputError: a database has one owner."""
        raise InputError("registration.profile `paper` keeps a database, of which no copy goes its own way")

    def _extract(self, view: Observation) -> int:
        name = f"{len(self._ids) + 1:06d}.png"
        folder = Path(self._folder.name)
        if not cv2.imwrite(str(folder / name), cv2.cvtColor(view.rgb, cv2.COLOR_RGB2BGR)):
            raise FuseError(f"could not write a picture for COLMAP into {folder}")
        # Without `existing_camera_id` every call makes a new camera, CameraMode.SINGLE or not.
        pycolmap.extract_features(
            str(self._database_path),
            str(folder),
            image_names=[name],
            camera_mode=pycolmap.CameraMode.SINGLE,
            camera_model="PINHOLE",
            reader_options=pycolmap.ImageReaderOptions(existing_camera_id=1),
            extraction_options=pycolmap.FeatureExtractionOptions(num_threads=1),
            device=pycolmap.Device.cpu,
        )
        with pycolmap.Database.open(str(self._database_path)) as database:
            written = database.read_image_with_name(name)
        if written is None:
            raise FuseError(f"COLMAP did not take the picture {name} into its database in {folder}")
        self._ids.append(written.image_id)
        return written.image_id
