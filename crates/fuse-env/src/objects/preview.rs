//! A picture of one object on a plain table, for contact sheets.

use std::sync::Arc;

use fuse_camera::{Camera, Pinhole, Pose, RgbBuffer};
use fuse_render::{Instance, Light, Material, Mesh, Model, RenderOptions, Renderer, Scene, SceneError};
use glam::{Affine3A, Quat, Vec2, Vec3};
use nalgebra::Point3;

use crate::catalogue::RestingPose;

/// Distance of the camera, metres.
const DISTANCE: f64 = 0.9;

/// A square picture, `pixels` wide, of a model resting in a pose, turned by `yaw` radians, seen
/// by a camera that looks down by `down` degrees; it fills the picture whatever its size.
///
/// # Errors
/// [`SceneError`] when the model is unsound.
pub fn preview(model: &Model, pose: &RestingPose, yaw: f32, down: f64, pixels: u32) -> Result<RgbBuffer, SceneError> {
    let turn = Quat::from_rotation_z(yaw) * pose.rotation();
    let points: Vec<Vec3> = model.meshes.iter().flat_map(|m| &m.positions).map(|p| turn * *p).collect();
    let low = points.iter().copied().reduce(Vec3::min).unwrap_or_default();
    let high = points.iter().copied().reduce(Vec3::max).unwrap_or_default();
    let middle = (low + high) / 2.0;
    let shift = Vec3::new(-middle.x, -middle.y, pose.height);
    let transform = Affine3A::from_rotation_translation(turn, shift);
    let scene = Scene {
        instances: vec![
            Instance { model: Arc::new(table()), transform: Affine3A::IDENTITY, id: 0 },
            Instance { model: Arc::new(model.clone()), transform, id: 1 },
        ],
        light: Light { position: Vec3::new(0.9, -0.8, 1.7), ..Light::default() },
        background: Vec3::splat(0.3),
    };
    let renderer = Renderer::new(scene, &RenderOptions { shadow_resolution: 1024, ..RenderOptions::default() })?;
    let target = Point3::new(0.0, 0.0, f64::from(high.z - low.z) / 2.0);
    let (s, c) = down.to_radians().sin_cos();
    let eye = target + nalgebra::Vector3::new(0.0, -DISTANCE * c, DISTANCE * s);
    let pose = Pose::look_at(eye, target);
    let half = points
        .iter()
        .map(|p| pose.to_camera(&Point3::from((*p + shift).as_dvec3().to_array())))
        .map(|q| (q.x / q.z).abs().max((q.y / q.z).abs()))
        .fold(1e-3, f64::max);
    let (size, focal) = (f64::from(pixels), f64::from(pixels) / (2.16 * half));
    let intrinsics = Pinhole::new(pixels, pixels, focal, focal, size / 2.0, size / 2.0)
        .map_err(|e| SceneError::Value { name: "pixels", expected: "at least 1", found: e.to_string() })?;
    Ok(renderer.render(&Camera { intrinsics, pose }).rgb)
}

/// Two metres square, grey-brown.
fn table() -> Model {
    let corner = |x: f32, y: f32| Vec3::new(x, y, 0.0);
    Model {
        meshes: vec![Mesh {
            positions: vec![corner(-1.0, -1.0), corner(1.0, -1.0), corner(1.0, 1.0), corner(-1.0, 1.0)],
            normals: vec![Vec3::Z; 4],
            uvs: vec![Vec2::ZERO; 4],
            triangles: vec![[0, 1, 2], [0, 2, 3]],
            material: 0,
        }],
        materials: vec![Material {
            name: "table".into(),
            base_color: [0.35, 0.30, 0.25, 1.0],
            base_color_texture: None,
            metallic: 0.0,
            roughness: 0.8,
            double_sided: false,
        }],
    }
}
