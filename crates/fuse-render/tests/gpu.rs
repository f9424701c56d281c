//! The GPU twin against the CPU's renderer, on the same scenes.

mod common;

use std::path::{Path, PathBuf};
use std::time::Instant;

use common::gpu::device;
use common::{camera, place, room, tabletop};
use fuse_camera::gpu::{GpuError, Software};
use fuse_camera::{Camera, IdBuffer};
use fuse_render::gpu::{Device, GpuRenderer, RenderError};
use fuse_render::{Frame, Instance, Light, RenderOptions, Renderer, Scene, load};
use glam::Vec3;

/// What issue and documentation promise.
const IDS: f64 = 0.999;
const DEPTH: f32 = 1e-4;
const COLOUR: u8 = 3;
const COLOURS: f64 = 0.99;

fn plain() -> RenderOptions {
    RenderOptions { shadows: false, ambient_occlusion: false, ..RenderOptions::default() }
}

/// Shipped objects on the table of the tests' room: textured, with thin and concave parts.
fn shipped() -> Scene {
    let folder = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../../python/fuse_grounding/data/objects");
    let mut files: Vec<PathBuf> = std::fs::read_dir(&folder)
        .unwrap_or_else(|e| panic!("{}: {e}", folder.display()))
        .map(|entry| entry.expect("a readable folder").path())
        .filter(|path| path.to_string_lossy().ends_with("_eval_0.glb"))
        .collect();
    files.sort();
    assert!(files.len() >= 24, "{} shipped objects", files.len());
    let objects = files.iter().step_by(files.len() / 12).take(12).enumerate().map(|(k, path)| {
        let model = load(path).expect("a shipped object");
        let low = model.bounds().expect("vertices").0.z;
        let at = Vec3::new(-0.39 + 0.26 * (k % 4) as f32, -0.24 + 0.24 * (k / 4) as f32, 0.75 - low);
        place(model, at, 0.7 * k as f32, k as u32 + 1)
    });
    let instances: Vec<Instance> = room().into_iter().chain(objects).collect();
    Scene { instances, light: Light::default(), background: Vec3::splat(0.1) }
}

/// Pixels away from edges: the neighbours show the same thing in both images, and the CPU's depth runs
/// on straight through the pixel.
fn inner(cpu: &Frame, gpu: &Frame, x: u32, y: u32) -> bool {
    let (w, h) = (cpu.rgb.width(), cpu.rgb.height());
    if x == 0 || y == 0 || x + 1 == w || y + 1 == h {
        return false;
    }
    let around = |k: u32| (x + k % 3 - 1, y + k / 3 - 1);
    let id = cpu.instance.get(x, y);
    let same = |ids: &IdBuffer| (0..9).map(around).all(|(x, y)| ids.get(x, y) == id);
    let depth = |k: u32| *cpu.depth.get(around(k).0, around(k).1);
    let straight = (0..4).all(|k| (depth(k) + depth(8 - k) - 2.0 * depth(4)).abs() <= 1e-3 * depth(4));
    same(&cpu.instance) && same(&gpu.instance) && straight
}

/// Shares of pixels: same id; depth within [`DEPTH`] among inner ones; colour within [`COLOUR`]. And the
/// mean difference of colours.
fn agreement(cpu: &Frame, gpu: &Frame) -> (f64, f64, f64, f64) {
    let (w, h) = (cpu.rgb.width(), cpu.rgb.height());
    let (mut ids, mut inners, mut depths, mut colours, mut sum) = (0u32, 0u32, 0u32, 0u32, 0f64);
    for (x, y) in (0..h).flat_map(|y| (0..w).map(move |x| (x, y))) {
        ids += u32::from(cpu.instance.get(x, y) == gpu.instance.get(x, y));
        if inner(cpu, gpu, x, y) {
            let (a, b) = (*cpu.depth.get(x, y), *gpu.depth.get(x, y));
            inners += 1;
            depths += u32::from((a - b).abs() <= DEPTH * a);
            if (a - b).abs() > DEPTH * a { eprintln!("{x} {y} {a} {b}"); }
        }
        let differences = [0, 1, 2].map(|c| cpu.rgb.get(x, y)[c].abs_diff(gpu.rgb.get(x, y)[c]));
        colours += u32::from(differences.iter().all(|&d| d <= COLOUR));
        sum += differences.iter().map(|&d| f64::from(d)).sum::<f64>();
    }
    let n = f64::from(w * h);
    let share = |count: u32, of: f64| f64::from(count) / of;
    (share(ids, n), share(depths, f64::from(inners)), share(colours, n), sum / (3.0 * n))
}

fn views(width: u32, height: u32) -> [(&'static str, Camera); 3] {
    [("front", [-0.2, -0.85, 1.4]), ("low", [0.75, 0.3, 1.0]), ("above", [0.01, 0.0, 2.2])]
        .map(|(name, eye)| (name, camera(width, height, eye, [0.0, 0.0, 0.75])))
}

fn assert_agreement(what: &str, device: &Device, scene: &Scene, options: &RenderOptions) {
    let cpu = Renderer::new(scene.clone(), options).unwrap();
    let gpu = GpuRenderer::new(scene.clone(), options, device).unwrap();
    assert_eq!(cpu.ids(), gpu.ids());
    for (view, cam) in views(640, 480) {
        let expected = cpu.render(&cam);
        let start = Instant::now();
        let found = gpu.render(&cam).unwrap();
        let ms = start.elapsed().as_secs_f64() * 1e3;
        let (ids, depths, colours, mean) = agreement(&expected, &found);
        println!(
            "{what}, {view}: ids {:.4} %, depth {:.4} % of inner pixels, colour {:.3} % (mean difference {mean:.4}), {ms:.0} ms",
            100.0 * ids,
            100.0 * depths,
            100.0 * colours
        );
        if let Some(folder) = std::env::var_os("FUSE_PICTURES") {
            for (name, frame) in [("cpu", &expected), ("gpu", &found)] {
                let pixels = frame.rgb.as_slice().as_flattened().to_vec();
                let path = Path::new(&folder).join(format!("{what}_{view}_{name}.png"));
                image::RgbImage::from_raw(640, 480, pixels).unwrap().save(path).unwrap();
            }
        }
        assert!(ids >= IDS, "{what}, {view}: ids agree on {ids:.5} of the pixels");
        assert!(depths == 1.0, "{what}, {view}: depths agree on {depths:.5} of the inner pixels");
        assert!(colours >= COLOURS, "{what}, {view}: colours agree on {colours:.4} of the pixels");
        let (depth, instance) = gpu.depth_ids(&cam).unwrap();
        assert!((depth, instance) == (found.depth, found.instance), "{what}, {view}: both paths see the same");
    }
}

#[test]
fn the_tabletop_looks_the_same() {
    let Some(device) = device() else { return };
    assert_agreement("tabletop", &device, &tabletop(15, 88), &RenderOptions::default());
}

#[test]
fn shipped_objects_look_the_same() {
    let Some(device) = device() else { return };
    assert_agreement("shipped", &device, &shipped(), &RenderOptions::default());
}

#[test]
fn without_shadow_and_occlusion_it_looks_the_same() {
    let Some(device) = device() else { return };
    assert_agreement("plain", &device, &tabletop(9, 32), &plain());
}
