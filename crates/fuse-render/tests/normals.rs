//! Normals against closed forms.

mod common;

use common::{camera, material, model, place, quad, sphere};
use fuse_camera::Camera;
use fuse_render::{Light, Model, RenderOptions, Renderer, Scene};
use glam::Vec3;
use nalgebra::{Point3, Vector3};

fn renderer(model: Model, at: Vec3) -> Renderer {
    let scene = Scene { instances: vec![place(model, at, 0.0, 5)], light: Light::default(), background: Vec3::ZERO };
    let plain = RenderOptions { shadows: false, ambient_occlusion: false, ..RenderOptions::default() };
    Renderer::new(scene, &plain).unwrap()
}

fn seen(n: &[f32; 3]) -> Vector3<f64> {
    Vector3::from(*n).cast()
}

#[test]
fn a_plane_has_one_normal_and_the_background_none() {
    let floor = quad(Vec3::new(-1.0, -1.0, 0.0), Vec3::X * 2.0, Vec3::Y * 2.0, 1.0);
    let r = renderer(model(floor, material([0.5; 3], 0.0, 0.5)), Vec3::ZERO);
    let cam = camera(160, 120, [0.3, -1.2, 1.0], [0.0, 0.0, 0.1]);
    let expected = cam.pose.rotation * Vector3::z();
    let (normals, (depth, _)) = (r.normals(&cam), r.depth_ids(&cam));
    let mut hits = 0;
    for (n, z) in normals.as_slice().iter().zip(depth.as_slice()) {
        if *z == 0.0 {
            assert_eq!(*n, [0.0; 3]);
        } else {
            assert!((seen(n) - expected).norm() < 1e-6, "{n:?} for {expected:?}");
            hits += 1;
        }
    }
    assert!(hits > 3000 && hits < 160 * 120, "{hits} pixels hit");
}

#[test]
fn a_sphere_has_its_radii_for_normals() {
    let (at, radius) = (Point3::new(1.0, 0.2, 0.9), 0.3);
    let r = renderer(model(sphere(0.3, 256), material([0.5; 3], 0.0, 0.5)), Vec3::new(1.0, 0.2, 0.9));
    let cam = camera(200, 150, [0.0, 0.0, 1.0], [1.0, 0.1, 0.95]);
    let (normals, (depth, ids)) = (r.normals(&cam), r.depth_ids(&cam));
    let mut hits = 0;
    for y in 0..150 {
        for x in 0..200 {
            let n = seen(normals.get(x, y));
            assert_eq!(*ids.get(x, y) == 5, n != Vector3::zeros());
            if *ids.get(x, y) != 5 {
                continue;
            }
            let (ray, found) = looked_at(&cam, x, y, *depth.get(x, y));
            assert!((n.norm() - 1.0).abs() < 1e-6);
            assert!(n.dot(&ray) <= 0.0, "({x}, {y}) faces away");
            // A facet's normal is within half its angle, π/256, times √2 of the sphere's anywhere on it.
            let expected = cam.pose.rotation * ((found - at) / radius);
            assert!(n.angle(&expected) < std::f64::consts::PI / 256.0 * 1.5, "({x}, {y}): {n:?} for {expected:?}");
            hits += 1;
        }
    }
    assert!(hits > 2000, "{hits} pixels hit");
}

#[test]
fn a_double_sided_sheet_faces_the_camera_from_either_side() {
    let mut sheet = material([0.5; 3], 0.0, 0.5);
    sheet.double_sided = true;
    let r = renderer(model(quad(Vec3::new(-1.0, -1.0, 0.0), Vec3::X * 2.0, Vec3::Y * 2.0, 1.0), sheet), Vec3::ZERO);
    for height in [1.0, -1.0] {
        let cam = camera(64, 48, [0.1, 0.0, height], [0.0, 0.0, 0.0]);
        let up = cam.pose.rotation * Vector3::new(0.0, 0.0, height);
        assert!((seen(r.normals(&cam).get(32, 24)) - up).norm() < 1e-6);
    }
}

fn looked_at(cam: &Camera, x: u32, y: u32, depth: f32) -> (Vector3<f64>, Point3<f64>) {
    let (u, v) = (f64::from(x) + 0.5, f64::from(y) + 0.5);
    (cam.intrinsics.unproject(u, v, 1.0).coords, cam.unproject(u, v, f64::from(depth)))
}
