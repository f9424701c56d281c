//! Shading against the documented model, evaluated in double precision on an analytic sphere.

mod common;

use common::backends::backends;
use common::{camera, material, model, place, sphere};
use fuse_camera::Camera;
use fuse_render::{Light, RenderOptions, Scene};
use glam::{DVec3, Vec3};
use nalgebra::{Matrix3, Vector3};

const RADIUS: f64 = 0.3;
const BASE: DVec3 = DVec3::new(0.7, 0.45, 0.25);
/// Largest difference in steps of 255: rounding of the encoded value, and the facets.
const STEPS: f64 = 1.0;

/// Where the ray through the centre of a pixel meets the sphere around the origin; `None` beside it and where
/// its rim is within 5 % of the radius.
fn hit(camera: &Camera, x: u32, y: u32) -> Option<(DVec3, DVec3)> {
    let k = &camera.intrinsics;
    let ray = Vector3::new((f64::from(x) + 0.5 - k.cx) / k.fx, (f64::from(y) + 0.5 - k.cy) / k.fy, 1.0);
    let to_world: Matrix3<f64> = camera.pose.rotation.to_rotation_matrix().matrix().transpose();
    let direction = DVec3::from_array((to_world * ray).normalize().into());
    let center = camera.pose.center();
    let eye = DVec3::new(center.x, center.y, center.z);
    let along = -eye.dot(direction);
    let beside = (eye + direction * along).length();
    (beside < 0.95 * RADIUS)
        .then(|| (eye + direction * (along - (RADIUS * RADIUS - beside * beside).sqrt()), -direction))
}

/// Radiance of a dielectric of colour [`BASE`] at `p` on the sphere towards `view`, without shadow and occlusion.
fn radiance(light: &Light, roughness: f64, p: DVec3, view: DVec3) -> DVec3 {
    let n = p / RADIUS;
    let nv = n.dot(view);
    let (sky, ground) = (light.sky.as_dvec3(), light.ground.as_dvec3());
    let mirror = 2.0 * nv * n - view;
    let alpha = roughness * roughness;

    // Light of the surroundings over the hemisphere, and as a lobe of this roughness sees it.
    let mut irradiance = ground.lerp(sky, (1.0 + n.z) / 2.0);
    let t = (0.5 + mirror.z / (0.3 + 1.7 * roughness)).clamp(0.0, 1.0);
    let mut mirrored = ground.lerp(sky, t * t * (3.0 - 2.0 * t)) + sky * 0.7 * (1.0 - mirror.z * mirror.z).powi(2);
    for b in &light.soft_boxes {
        let (d, color, s) = (b.direction.as_dvec3().normalize(), b.color.as_dvec3(), f64::from(b.sharpness));
        irradiance += color * 2.0 / (1.0 + s) * ((1.0 + n.dot(d)) / 2.0).powi(2);
        let blurred = s / (1.0 + s * alpha);
        mirrored += color * (1.0 + blurred) / (1.0 + s) / (1.0 + blurred * (1.0 - mirror.dot(d))).powi(2);
    }
    // Karis 2014, with (1 - nv)⁵ for its exponential.
    let (a, b) = (1.0 - roughness, 0.0425 - 0.0275 * roughness);
    let c = (a * a).min((1.0 - nv).powi(5)) * a + b;
    let reflectance = 0.04 * (1.04 - 0.572 * roughness - 1.04 * c) + 1.04 * c + 0.022 * roughness - 0.04;
    let ambient = BASE * irradiance + reflectance * mirrored;

    // Lambert and GGX under the lamp, whose size widens the highlight.
    let to_lamp = light.position.as_dvec3() - p;
    let (l, distance) = (to_lamp.normalize(), to_lamp.length());
    let nl = n.dot(l);
    if nl <= 0.0 {
        return ambient;
    }
    let h = (l + view).normalize();
    let wide = (alpha + 0.5 * f64::from(light.radius) / distance).min(1.0);
    // Times π, as the lamp's intensity is over π.
    let distribution = (wide / (n.dot(h).powi(2) * (wide * wide - 1.0) + 1.0)).powi(2);
    let smith = |c: f64| c / (c * (1.0 - alpha / 2.0) + alpha / 2.0);
    let fresnel = 0.04 + 0.96 * (1.0 - view.dot(h)).powi(5);
    let specular = distribution * smith(nl) * smith(nv) * fresnel / (4.0 * nl * nv);
    ambient + (BASE + specular) * light.intensity.as_dvec3() * nl / (distance * distance)
}

/// Linear [0, 1] to sRGB, in steps of 255.
fn srgb(v: f64) -> f64 {
    255.0 * if v <= 0.003_130_8 { 12.92 * v } else { 1.055 * v.powf(1.0 / 2.4) - 0.055 }
}

#[test]
fn a_sphere_is_shaded_as_documented() {
    let options = RenderOptions { shadows: false, ambient_occlusion: false, ..RenderOptions::default() };
    let light = Light::default();
    let cam = camera(200, 150, [1.0, 0.7, -0.2], [0.0; 3]);
    for roughness in [0.95, 0.6] {
        let ball = model(sphere(RADIUS as f32, 400), material(BASE.as_vec3().to_array(), 0.0, roughness));
        let instances = vec![place(ball, Vec3::ZERO, 0.0, 1)];
        let scene = Scene { instances, light: light.clone(), background: Vec3::ZERO };
        for r in backends(&scene, &options) {
            let frame = r.render(&cam);
            let (mut seen, mut worst, mut lit) = (0, 0.0f64, 0);
            for (x, y) in (0..150).flat_map(|y| (0..200).map(move |x| (x, y))) {
                let Some((p, view)) = hit(&cam, x, y) else { continue };
                let expected = radiance(&light, f64::from(roughness), p, view);
                assert!(expected.max_element() < 0.76, "the tone curve is straight up to there: {expected}");
                let found = frame.rgb.get(x, y).map(f64::from);
                for c in 0..3 {
                    worst = worst.max((found[c] - srgb(expected[c])).abs());
                }
                seen += 1;
                lit += usize::from(p.dot(light.position.as_dvec3() - p) > 0.0);
            }
            println!("{}, roughness {roughness}: {seen} pixels, off by {worst:.3} of 255", r.name);
            assert!(seen > 3000 && lit > 1000 && seen - lit > 500, "{seen} pixels, {lit} of them lit");
            assert!(worst <= STEPS, "{}, roughness {roughness}: off by {worst:.3} of 255", r.name);
        }
    }
}
