//! Colour: shading, shadow, anti-aliasing, threads, golden pictures.

mod common;

use std::path::PathBuf;

use common::backends::backends;
use common::{camera, material, model, place, quad, room, sphere, tabletop, texture, textured};
use fuse_render::{Frame, Light, RenderOptions, Renderer, Scene};
use glam::Vec3;

fn plain() -> RenderOptions {
    RenderOptions { shadows: false, ambient_occlusion: false, ..RenderOptions::default() }
}

fn luminance(frame: &Frame, x: u32, y: u32) -> f32 {
    let [r, g, b] = frame.rgb.get(x, y).map(f32::from);
    (0.2126 * r + 0.7152 * g + 0.0722 * b) / 255.0
}

fn dark_light(position: Vec3, radius: f32) -> Light {
    let zero = Vec3::ZERO;
    Light { position, radius, sky: zero, ground: zero, soft_boxes: Vec::new(), ..Light::default() }
}

/// A matt white floor under a lamp at height 2 without ambient light, and a plate of radius
/// ~0.2 m at height 0.5.
fn plate_over_floor(radius: f32) -> Scene {
    let white = || material([0.8; 3], 0.0, 1.0);
    let floor = quad(Vec3::new(-2.0, -2.0, 0.0), Vec3::X * 4.0, Vec3::Y * 4.0, 1.0);
    let plate = quad(Vec3::new(-0.2, -0.2, 0.5), Vec3::X * 0.4, Vec3::Y * 0.4, 1.0);
    Scene {
        instances: vec![
            place(model(floor, white()), Vec3::ZERO, 0.0, 0),
            place(model(plate, white()), Vec3::ZERO, 0.0, 1),
        ],
        light: dark_light(Vec3::new(0.0, 0.0, 2.0), radius),
        background: Vec3::ZERO,
    }
}

#[test]
fn the_side_towards_the_lamp_is_bright_and_the_other_dark() {
    let ball = place(model(sphere(0.3, 64), material([0.7; 3], 0.0, 0.8)), Vec3::ZERO, 0.0, 1);
    for (lamp, bright) in [([0.0, -3.0, 1.0], -1), ([0.0, 3.0, 1.0], 1)] {
        let scene =
            Scene { instances: vec![ball.clone()], light: dark_light(Vec3::from(lamp), 0.1), background: Vec3::ZERO };
        // Looking along +x, world y points to the image's left.
        for r in backends(&scene, &RenderOptions::default()) {
            let frame = r.render(&camera(101, 101, [-1.2, 0.0, 0.0], [0.0, 0.0, 0.0]));
            let (left, right) = (luminance(&frame, 33, 50), luminance(&frame, 67, 50));
            let (lit, unlit) = if bright > 0 { (left, right) } else { (right, left) };
            assert!(lit > 0.25 && unlit == 0.0, "{}, lamp at {lamp:?}: left {left}, right {right}", r.name);
            assert_eq!(*frame.rgb.get(1, 1), [0; 3], "background");
        }
    }
}

#[test]
fn lambert_reflection_has_the_stated_brightness() {
    // Albedo 0.5 one metre below a lamp of intensity 0.6, no highlight at roughness 1 to speak of.
    let floor = quad(Vec3::new(-2.0, -2.0, 0.0), Vec3::X * 4.0, Vec3::Y * 4.0, 1.0);
    let mut light = dark_light(Vec3::new(0.0, 0.0, 1.0), 0.0);
    light.intensity = Vec3::splat(0.6);
    let scene = Scene {
        instances: vec![place(model(floor, material([0.5; 3], 0.0, 1.0)), Vec3::ZERO, 0.0, 0)],
        light,
        background: Vec3::ZERO,
    };
    for r in backends(&scene, &RenderOptions::default()) {
        let frame = r.render(&camera(65, 65, [0.8, 0.0, 1.5], [0.0; 3]));
        let srgb = f64::from(frame.rgb.get(32, 32)[1]) / 255.0;
        let linear = ((srgb + 0.055) / 1.055).powf(2.4);
        assert!((0.30..0.32).contains(&linear), "{}: radiance {linear}, 0.3 and a little highlight expected", r.name);
    }
}

#[test]
fn shadows_are_where_geometry_puts_them_and_soften_with_the_lamp() {
    // The plate's shadow on the floor is its size times 2 / 1.5: half-width 0.2667 m.
    // Seen from below the plate.
    let cam = camera(401, 401, [0.9, 0.25, 0.45], [0.0, 0.25, 0.0]);
    let edge = 0.2 * 2.0 / 1.5;
    let at = |frame: &Frame, y: f64| {
        let (u, v, _) = cam.project(&nalgebra::Point3::new(0.0, y, 0.0)).unwrap();
        luminance(frame, u as u32, v as u32)
    };
    for (radius, penumbra) in [(0.0, 0.0), (0.1, 0.1 * 0.5 / 1.5)] {
        for r in backends(&plate_over_floor(radius), &RenderOptions::default()) {
            let frame = r.render(&cam);
            let lit = at(&frame, edge + penumbra + 0.02);
            assert!(lit > 0.5, "lit floor beside the shadow: {lit}");
            let dark = at(&frame, edge - penumbra - 0.012);
            assert!(dark < 0.02 * lit, "{}, radius {radius}: umbra {dark}", r.name);
            if penumbra > 0.0 {
                let share = |y: f64| (f64::from(at(&frame, y) / lit)).powf(2.2);
                let (outer, middle, inner) = (share(edge + penumbra * 0.5), share(edge), share(edge - penumbra * 0.5));
                assert!((0.35..0.65).contains(&middle), "half of the lamp at the geometric edge: {middle}");
                assert!(outer > middle + 0.15 && inner < middle - 0.15, "{inner} < {middle} < {outer}");
            }
        }
    }
}

#[test]
fn a_floor_does_not_shadow_itself_at_any_angle() {
    let floor = quad(Vec3::new(-2.0, -2.0, 0.0), Vec3::X * 4.0, Vec3::Y * 4.0, 1.0);
    for tilt in [0.0f32, 0.4, 0.9] {
        let mut instance = place(model(floor.clone(), material([0.8; 3], 0.0, 1.0)), Vec3::ZERO, 0.0, 1);
        instance.transform = glam::Affine3A::from_rotation_y(tilt);
        let scene = Scene {
            instances: vec![instance],
            light: dark_light(Vec3::new(0.5, 0.3, 3.0), 0.15),
            background: Vec3::ZERO,
        };
        let cam = camera(160, 120, [-0.5, 0.0, 2.5], [0.0; 3]);
        let with =
            Renderer::new(scene.clone(), &RenderOptions { ambient_occlusion: false, ..RenderOptions::default() });
        let (with, without) = (with.unwrap().render(&cam), Renderer::new(scene, &plain()).unwrap().render(&cam));
        assert_eq!(with.rgb, without.rgb, "tilt {tilt}: an unoccluded plane must be fully lit");
    }
}

#[test]
fn a_wall_beside_a_large_lamp_does_not_shadow_itself() {
    let wall = quad(Vec3::new(1.5, 2.0, 0.0), Vec3::NEG_Y * 4.0, Vec3::Z * 2.1, 1.0);
    let floor = quad(Vec3::new(-2.0, -2.0, 0.0), Vec3::X * 4.0, Vec3::Y * 4.0, 1.0);
    let white = || material([0.8; 3], 0.0, 1.0);
    for (yaw, radius, x) in [(0.0, 0.1, 0.0), (0.2, 0.2, 0.0), (0.7, 0.3, 0.0), (0.0, 0.15, 1.2), (0.1, 0.15, 1.3)] {
        let scene = Scene {
            instances: vec![
                place(model(wall.clone(), white()), Vec3::ZERO, yaw, 0),
                place(model(floor.clone(), white()), Vec3::ZERO, 0.0, 0),
            ],
            light: dark_light(Vec3::new(x, 0.0, 2.3), radius),
            background: Vec3::ZERO,
        };
        let cam = camera(160, 120, [0.2, 0.1, 1.2], [1.5, 0.3, 1.2]);
        let (with, without) = (
            Renderer::new(scene.clone(), &RenderOptions::default()).unwrap().render(&cam),
            Renderer::new(scene, &plain()).unwrap().render(&cam),
        );
        let differences = with.rgb.as_slice().iter().zip(without.rgb.as_slice());
        let darker = differences.filter(|(a, b)| a[1] + 2 < b[1]).count();
        assert_eq!(darker, 0, "yaw {yaw}, radius {radius}, x {x}: {darker} pixels are in a shadow of nothing");
    }
}

#[test]
fn edges_are_anti_aliased_with_the_covered_share() {
    // A white half plane whose edge crosses the image at a slant, emitting nothing else.
    let wall = quad(Vec3::new(2.0, -1.5, -9.0), Vec3::new(0.0, -9.0, 0.0), Vec3::new(0.0, 3.0, 18.0), 1.0);
    let mut light = dark_light(Vec3::new(-1.0, 0.0, 0.0), 0.0);
    light.intensity = Vec3::ZERO;
    light.sky = Vec3::ONE * 0.7;
    light.ground = Vec3::ONE * 0.7;
    let scene = Scene {
        instances: vec![place(model(wall, material([1.0; 3], 0.0, 1.0)), Vec3::ZERO, 0.07, 1)],
        light,
        background: Vec3::ZERO,
    };
    for r in backends(&scene, &plain()) {
        let frame = r.render(&camera(64, 48, [0.0; 3], [1.0, 0.0, 0.0]));
        let row: Vec<[u8; 3]> = frame.rgb.as_slice().to_vec();
        let full = row.iter().map(|c| c[1]).max().unwrap();
        let linear = |v: u8| (f32::from(v) / f32::from(full)).powf(2.2);
        let partial = row.iter().filter(|c| (0.05..0.95).contains(&linear(c[1]))).count();
        assert!((30..=110).contains(&partial), "{partial} pixels of the edge are mixed");
        // Summed coverage equals the area left of the edge to a fraction of a pixel a row.
        let covered: f32 = row.iter().map(|c| linear(c[1])).sum();
        let centers = frame.instance.as_slice().iter().filter(|&&id| id == 1).count() as f32;
        assert!((covered - centers).abs() < 6.0, "{}: covered {covered}, centres {centers}", r.name);
    }
}

#[test]
fn distant_texture_fades_to_its_mean_instead_of_aliasing() {
    let black_white =
        texture(64, |u, v| if ((u * 16.0) as u32 + (v * 16.0) as u32).is_multiple_of(2) { [0.0; 3] } else { [1.0; 3] });
    let floor = quad(Vec3::new(-40.0, -40.0, 0.0), Vec3::X * 80.0, Vec3::Y * 80.0, 8.0);
    let mut light = dark_light(Vec3::Z * 30.0, 0.0);
    (light.intensity, light.sky, light.ground) = (Vec3::ZERO, Vec3::ONE, Vec3::ONE);
    let scene = Scene {
        instances: vec![place(model(floor, textured(black_white, 1.0)), Vec3::ZERO, 0.3, 0)],
        light,
        background: Vec3::ZERO,
    };
    for r in backends(&scene, &plain()) {
        let frame = r.render(&camera(120, 90, [0.0, 0.0, 3.0], [10.0, 0.0, 0.0]));
        for (x, y) in (30..60).flat_map(|y| (0..120).map(move |x| (x, y))) {
            let l = luminance(&frame, x, y);
            // Mean of black and white in linear light is 0.5, in sRGB 0.735.
            assert!((l - 0.735).abs() < 0.05, "{}, ({x}, {y}): {l}", r.name);
        }
    }
}

#[test]
fn frames_are_the_same_for_any_number_of_threads() {
    let run = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| {
            let r = Renderer::new(tabletop(9, 24), &RenderOptions::default()).unwrap();
            let cam = camera(333, 251, [0.6, -0.6, 1.3], [0.0, 0.0, 0.75]);
            (r.render(&cam), r.amodal_all(&cam))
        })
    };
    let one = run(1);
    for threads in [2, 5] {
        assert!(run(threads) == one, "{threads} threads differ from one");
    }
}

#[test]
fn values_out_of_range_are_refused_by_name() {
    let scene = || Scene { instances: room(), light: Light::default(), background: Vec3::ZERO };
    let message = |scene: Scene, options: RenderOptions| Renderer::new(scene, &options).err().unwrap().to_string();
    let mut s = scene();
    s.light.radius = f32::NAN;
    assert!(message(s, plain()).contains("light.radius"));
    let mut s = scene();
    s.light.sky.x = -1.0;
    assert!(message(s, plain()).contains("light.sky"));
    let mut s = scene();
    s.instances[1].transform.matrix3 *= 0.0;
    assert!(message(s, plain()).contains("instance 1"));
    assert!(message(scene(), RenderOptions { shadow_resolution: 10, ..plain() }).contains("shadow_resolution"));
    assert!(message(scene(), RenderOptions { near: 0.0, ..plain() }).contains("near"));
}

/// Pictures that people have looked at. Tolerance: mean absolute difference 0.5 of 255, no pixel
/// beyond 24 (a texel at an edge may fall on the other side on another machine).
/// `FUSE_BLESS=1 cargo test` writes them anew.
#[test]
fn golden_tabletop() {
    let r = Renderer::new(tabletop(15, 48), &RenderOptions::default()).unwrap();
    for (name, eye) in [("tabletop_front", [-0.2, -0.85, 1.4]), ("tabletop_low", [0.75, 0.3, 1.0])] {
        let frame = r.render(&camera(320, 240, eye, [0.0, 0.0, 0.75]));
        let path = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join(format!("tests/golden/{name}.png"));
        let pixels = frame.rgb.as_slice().as_flattened().to_vec();
        if std::env::var_os("FUSE_BLESS").is_some() {
            std::fs::create_dir_all(path.parent().unwrap()).unwrap();
            image::RgbImage::from_raw(320, 240, pixels).unwrap().save(&path).unwrap();
            continue;
        }
        let golden = image::open(&path).expect("golden picture").into_rgb8().into_raw();
        let differences: Vec<u8> = golden.iter().zip(&pixels).map(|(a, b)| a.abs_diff(*b)).collect();
        let mean = differences.iter().map(|&d| f64::from(d)).sum::<f64>() / differences.len() as f64;
        let worst = differences.iter().max().unwrap();
        assert!(mean < 0.5 && *worst <= 24, "{name}: mean difference {mean:.3}, worst {worst}");
    }
}
