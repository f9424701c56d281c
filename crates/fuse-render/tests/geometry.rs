//! Depth and ids against closed forms.

mod common;

use common::backends::{Prepared, backends};
use common::{camera, cuboid, material, model, place, quad, sphere, tabletop};
use fuse_camera::Camera;
use fuse_render::{Light, RenderOptions, Renderer, Scene};
use glam::Vec3;
use nalgebra::Point3;

fn plain() -> RenderOptions {
    RenderOptions { shadows: false, ambient_occlusion: false, ..RenderOptions::default() }
}

fn scene(instances: Vec<fuse_render::Instance>) -> Scene {
    Scene { instances, light: Light::default(), background: Vec3::ZERO }
}

#[test]
fn plane_depth_is_exact_up_to_the_horizon_and_behind_the_camera() {
    // A huge floor in two triangles: vertices behind the camera and far beyond the image.
    let floor = quad(Vec3::new(-500.0, -500.0, 0.0), Vec3::X * 1000.0, Vec3::Y * 1000.0, 1.0);
    let s = scene(vec![place(model(floor, material([0.5; 3], 0.0, 0.5)), Vec3::ZERO, 0.0, 7)]);
    let cam = camera(160, 120, [0.3, -0.2, 1.4], [1.5, 0.4, 1.1]);
    for r in backends(&s, &plain()) {
        plane_is_exact(&r, &cam);
    }
}

fn plane_is_exact(r: &Prepared, cam: &Camera) {
    let (depth, ids) = r.depth_ids(cam);
    let eye = cam.pose.center();
    let mut hits = 0;
    for y in 0..120 {
        for x in 0..160 {
            let far = cam.unproject(f64::from(x) + 0.5, f64::from(y) + 0.5, 1.0);
            let slope = eye.z - far.z;
            let expected = if slope > 0.0 { eye.z / slope } else { f64::INFINITY };
            let inside = eye + (far - eye) * expected;
            if expected.is_finite() && inside.x.abs() < 499.0 && inside.y.abs() < 499.0 {
                let found = f64::from(*depth.get(x, y));
                let error = (found / expected - 1.0).abs();
                assert!(error < r.rounding(), "{}, ({x}, {y}): {found} for {expected}", r.name);
                assert_eq!(*ids.get(x, y), 7);
                hits += 1;
            } else if slope <= 0.0 {
                assert_eq!((*depth.get(x, y), *ids.get(x, y)), (0.0, 0));
            }
        }
    }
    assert!(hits > 160 * 40, "only {hits} pixels hit the floor");
}

#[test]
fn sphere_depth_and_silhouette_match_the_quadric() {
    let at = Vec3::new(1.0, 0.2, 0.9);
    let s = scene(vec![place(model(sphere(0.3, 256), material([0.5; 3], 0.0, 0.5)), at, 0.0, 3)]);
    let cam = camera(200, 150, [0.0, 0.0, 1.0], [1.0, 0.1, 0.95]);
    for r in backends(&s, &plain()) {
        sphere_matches(&r, &cam);
    }
}

fn sphere_matches(renderer: &Prepared, cam: &Camera) {
    let (r, c) = (0.3f64, Point3::new(1.0, 0.2, 0.9));
    let (depth, ids) = renderer.depth_ids(cam);
    let eye = cam.pose.center();
    let mut wrong_ids = 0;
    for y in 0..150 {
        for x in 0..200 {
            let d = cam.unproject(f64::from(x) + 0.5, f64::from(y) + 0.5, 1.0) - eye;
            let (a, b, q) = (d.norm_squared(), d.dot(&(c - eye)), (c - eye).norm_squared() - r * r);
            let disc = b * b - a * q;
            wrong_ids += u32::from((disc > 0.0) != (*ids.get(x, y) == 3));
            // Away from the rim the facets are within r (1 - cos(π/512)) of the sphere.
            if disc > 0.02 * a {
                let expected = (b - disc.sqrt()) / a;
                let found = f64::from(*depth.get(x, y));
                assert!((found - expected).abs() < 1e-4, "({x}, {y}): {found} for {expected}");
            }
        }
    }
    assert!(wrong_ids <= 4, "{wrong_ids} pixels of the silhouette differ");
}

#[test]
fn shared_edges_leave_no_holes() {
    // A finely cut floor that fills the view: every pixel must be hit.
    let n = 90;
    let tile = |i: i32| {
        let (x, y) = ((i % n - n / 2) as f32 * 0.0531, (i / n - n / 2) as f32 * 0.0471);
        quad(Vec3::new(x, y, 0.0), Vec3::X * 0.0531, Vec3::Y * 0.0471, 1.0)
    };
    let mut mesh = common::merge((0..n * n).map(tile));
    // Corners of neighbouring tiles must be the same numbers.
    for p in &mut mesh.positions {
        *p = Vec3::new((p.x / 0.0531).round() * 0.0531, (p.y / 0.0471).round() * 0.0471, 0.0);
    }
    let s = scene(vec![place(model(mesh, material([0.5; 3], 0.0, 0.5)), Vec3::ZERO, 0.3, 1)]);
    for r in backends(&s, &plain()) {
        for eye in [[0.01, 0.02, 1.0], [0.3, -0.4, 0.7], [0.111, 0.05, 0.33]] {
            let frame = r.render(&camera(320, 240, eye, [0.0, 0.01, 0.0]));
            assert!(frame.instance.as_slice().iter().all(|&id| id == 1), "{}: a hole seen from {eye:?}", r.name);
        }
    }
}

#[test]
fn near_plane_hides_what_is_closer() {
    let wall = quad(Vec3::new(0.05, 1.0, -1.0), Vec3::NEG_Y * 2.0, Vec3::Z * 2.0, 1.0);
    let far = quad(Vec3::new(1.0, 1.0, -1.0), Vec3::NEG_Y * 2.0, Vec3::Z * 2.0, 1.0);
    let m = || material([0.5; 3], 0.0, 0.5);
    let instances = vec![place(model(wall, m()), Vec3::ZERO, 0.0, 1), place(model(far, m()), Vec3::ZERO, 0.0, 2)];
    let cam = camera(32, 24, [0.0, 0.0, 0.0], [1.0, 0.0, 0.0]);
    for (near, id, z) in [(0.01, 1, 0.05), (0.06, 2, 1.0)] {
        for r in backends(&scene(instances.clone()), &RenderOptions { near, ..plain() }) {
            let (depth, ids) = r.depth_ids(&cam);
            assert_eq!((*ids.get(16, 12), *depth.get(16, 12)), (id, z), "{}, near = {near}", r.name);
        }
    }
}

#[test]
fn back_faces_show_on_double_sided_materials_only() {
    let cam = camera(32, 24, [0.0, 0.0, 0.0], [1.0, 0.0, 0.0]);
    for double_sided in [false, true] {
        let mut m =
            model(quad(Vec3::new(1.0, -1.0, -1.0), Vec3::Y * 2.0, Vec3::Z * 2.0, 1.0), material([0.5; 3], 0.0, 0.5));
        m.materials[0].double_sided = double_sided;
        for r in backends(&scene(vec![place(m, Vec3::ZERO, 0.0, 5)]), &plain()) {
            let (_, ids) = r.depth_ids(&cam);
            assert_eq!(*ids.get(16, 12), if double_sided { 5 } else { 0 }, "{}", r.name);
        }
    }
}

#[test]
fn a_mirroring_transform_keeps_the_outside_outside() {
    let mut instance = place(model(cuboid(Vec3::splat(0.2)), material([0.5; 3], 0.0, 0.5)), Vec3::ZERO, 0.0, 4);
    instance.transform = glam::Affine3A::from_scale(Vec3::new(-1.0, 1.0, 1.0));
    for r in backends(&scene(vec![instance]), &plain()) {
        let (depth, _) = r.depth_ids(&camera(33, 25, [1.0, 0.0, 0.0], [0.0, 0.0, 0.0]));
        assert!((depth.get(16, 12) - 0.8).abs() < 1e-6, "{}", r.name);
    }
}

#[test]
fn amodal_counts_agree_with_rendering_each_thing_alone() {
    let full = tabletop(15, 32);
    let r = Renderer::new(full.clone(), &plain()).unwrap();
    let cam = camera(320, 240, [0.7, -0.5, 1.1], [0.0, 0.0, 0.75]);
    let (depth, ids) = r.depth_ids(&cam);
    let frame = r.render(&cam);
    assert_eq!((&frame.depth, &frame.instance), (&depth, &ids), "both paths see the same");
    let all = r.amodal_all(&cam);
    assert_eq!(all.iter().map(|a| a.id).collect::<Vec<_>>(), r.ids());
    let mut occluded = 0;
    for a in &all {
        let alone = full.instances.iter().filter(|i| i.id == a.id).cloned().collect();
        let (_, lone) = Renderer::new(scene(alone), &plain()).unwrap().depth_ids(&cam);
        let count = |ids: &[u32]| ids.iter().filter(|&&i| i == a.id).count() as u32;
        assert_eq!(a.visible_px, count(ids.as_slice()), "visible pixels of {}", a.id);
        assert_eq!(a.unoccluded_px, count(lone.as_slice()), "unoccluded pixels of {}", a.id);
        occluded += u32::from(a.visible_px < a.unoccluded_px);
        assert_eq!(r.amodal(&cam, a.id), *a);
    }
    assert!(occluded >= 3, "the scene must have occlusion for this test to mean anything");
}
