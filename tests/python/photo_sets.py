"""Posed photos on disk as other programs write them: COLMAP models by pycolmap, nerfstudio's JSON."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import pycolmap
from tabletop_twin import Face

from fuse_grounding._core import Camera


@dataclass(frozen=True)
class PhotoSet:
    """Views and coloured points of a scene."""

    images: list[np.ndarray]
    cameras: list[Camera]
    xyz: np.ndarray
    rgb: np.ndarray

    @property
    def names(self) -> list[str]:
        return [f"view {i:03d}.png" for i in range(len(self.images))]

    def write_images(self, folder: Path) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        for name, image in zip(self.names, self.images, strict=True):
            assert cv2.imwrite(str(folder / name), image[..., ::-1])

    def reconstruction(self, model: str = "PINHOLE", params: list[float] | None = None):
        """A pycolmap model; images are entered in reverse, so that ids do not follow names."""
        one = self.cameras[0]
        made = pycolmap.Reconstruction()
        values = params if params is not None else [one.fx, one.fy, one.cx, one.cy]
        camera = pycolmap.Camera(camera_id=3, model=model, width=one.width, height=one.height, params=values)
        made.add_camera(camera)
        rig = pycolmap.Rig(rig_id=1)
        rig.add_ref_sensor(camera.sensor_id)
        made.add_rig(rig)
        for i in reversed(range(len(self.images))):
            view = self.cameras[i]
            matrix = np.hstack([view.rotation, view.translation[:, None]])
            observed = np.array([[1.5, 2.5], [7.0, 3.0]])
            image = pycolmap.Image(name=self.names[i], keypoints=observed, camera_id=3, image_id=900 - i)
            frame = pycolmap.Frame(frame_id=image.image_id, rig_id=1)
            frame.add_data_id(image.data_id)
            frame.rig_from_world = pycolmap.Rigid3d(matrix)
            made.add_frame(frame)
            image.frame_id = frame.frame_id
            made.add_image(image)
            made.register_frame(frame.frame_id)
        for p, c in zip(self.xyz, self.rgb, strict=True):
            made.add_point3D(p, pycolmap.Track(), c)
        return made

    def write_colmap(self, folder: Path, text: bool = False) -> Path:
        self.write_images(folder / "images")
        sparse = folder / "sparse" / "0"
        sparse.mkdir(parents=True)
        model = self.reconstruction()
        (model.write_text if text else model.write_binary)(sparse)
        return folder

    def write_nerfstudio(self, folder: Path, points: bool = True) -> Path:
        self.write_images(folder / "images")
        one = self.cameras[0]
        frames = []
        for name, view in zip(self.names, self.cameras, strict=True):
            to_world = np.eye(4)
            to_world[:3, :3] = view.rotation.T @ np.diag([1.0, -1.0, -1.0])
            to_world[:3, 3] = view.center
            frames.append({"file_path": f"images/{name}", "transform_matrix": to_world.tolist()})
        value = {
            "camera_model": "OPENCV",
            "w": one.width,
            "h": one.height,
            "fl_x": one.fx,
            "fl_y": one.fy,
            "cx": one.cx,
            "cy": one.cy,
            "frames": frames,
        }
        if points:
            # As nerfstudio writes it: in ASCII.
            rows = [
                f"{x:.8f} {y:.8f} {z:.8f} {r} {g} {b}"
                for (x, y, z), (r, g, b) in zip(self.xyz, self.rgb, strict=True)
            ]
            kinds = [f"property float {a}" for a in "xyz"]
            kinds += [f"property uint8 {c}" for c in ("red", "green", "blue")]
            head = ["ply", "format ascii 1.0", f"element vertex {len(rows)}", *kinds, "end_header"]
            (folder / "sparse_pc.ply").write_text("\n".join([*head, *rows]) + "\n")
            value["ply_file_path"] = "sparse_pc.ply"
        (folder / "transforms.json").write_text(json.dumps(value))
        return folder


def sample_points(faces: list[Face], count: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Points on faces, uniform by area, with their texture's colour."""
    rng = np.random.default_rng(seed)
    areas = np.array([np.linalg.norm(np.cross(f.u, f.v)) for f in faces])
    xyz, rgb = [], []
    for k in rng.choice(len(faces), count, p=areas / areas.sum()):
        face, (a, b) = faces[k], rng.random(2)
        xyz.append(face.corner + a * face.u + b * face.v)
        height, width = face.texture.shape[:2]
        rgb.append(face.texture[min(int(b * height), height - 1), min(int(a * width), width - 1)])
    return np.array(xyz), np.array(rgb, np.uint8)
