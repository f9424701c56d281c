//! The GPU twin against the CPU's renderer, on the same scenes.

mod common;

use std::path::{Path, PathBuf};
use std::time::Instant;

use common::gpu::device;
use common::{camera, place, room, tabletop};
use fuse_camera::gpu::{GpuError, Request, Software};
use fuse_camera::{Camera, IdBuffer};
use fuse_render::gpu::{Backend, Choice, Device, GpuRenderer, RenderError};
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

#[test]
fn the_same_adapter_gives_the_same_bits_again() {
    let Some(device) = device() else { return };
    let new = || GpuRenderer::new(tabletop(9, 24), &RenderOptions::default(), &device).unwrap();
    let (first, second) = (new(), new());
    let [(_, one), (_, other), _] = views(333, 251);
    let frame = first.render(&one).unwrap();
    // Another view and another size in between.
    first.render(&other).unwrap();
    first.depth_ids(&camera(64, 48, [1.0, 0.0, 1.2], [0.0, 0.0, 0.75])).unwrap();
    assert!(first.render(&one).unwrap() == frame, "a second time");
    assert!(second.render(&one).unwrap() == frame, "a second renderer");
}

#[test]
fn amodal_counts_are_those_of_the_cpu() {
    let Some(device) = device() else { return };
    let scene = tabletop(15, 32);
    let cpu = Renderer::new(scene.clone(), &plain()).unwrap();
    let gpu = GpuRenderer::new(scene, &plain(), &device).unwrap();
    let cam = camera(320, 240, [0.7, -0.5, 1.1], [0.0, 0.0, 0.75]);
    let (expected, found) = (cpu.amodal_all(&cam), gpu.amodal_all(&cam).unwrap());
    assert!(expected.iter().any(|a| a.visible_px < a.unoccluded_px), "nothing is occluded");
    assert_eq!(expected.len(), found.len());
    for (a, b) in expected.iter().zip(&found) {
        assert_eq!(a.id, b.id);
        let off = (a.visible_px.abs_diff(b.visible_px)).max(a.unoccluded_px.abs_diff(b.unoccluded_px));
        assert!(off <= 2, "{a:?} on the CPU, {b:?} on the GPU");
    }
}

#[test]
fn an_empty_scene_is_background() {
    let Some(device) = device() else { return };
    let scene = Scene { instances: Vec::new(), light: Light::default(), background: Vec3::new(0.2, 0.4, 0.9) };
    let cam = camera(33, 25, [0.0; 3], [1.0, 0.0, 0.0]);
    let expected = Renderer::new(scene.clone(), &RenderOptions::default()).unwrap().render(&cam);
    let gpu = GpuRenderer::new(scene, &RenderOptions::default(), &device).unwrap();
    assert_eq!(gpu.render(&cam).unwrap(), expected);
    assert!(gpu.amodal_all(&cam).unwrap().is_empty());
}

#[test]
fn what_cannot_be_rendered_is_named() {
    let Some(device) = device() else { return };
    let mut broken = tabletop(1, 8);
    broken.light.radius = f32::NAN;
    let error = GpuRenderer::new(broken, &plain(), &device).err().unwrap();
    assert!(matches!(error, RenderError::Scene(_)) && error.to_string().contains("light.radius"), "{error}");
    let gpu = GpuRenderer::new(tabletop(1, 8), &plain(), &device).unwrap();
    let error = gpu.render(&camera(16_384, 8, [0.0; 3], [1.0, 0.0, 0.0])).unwrap_err();
    let expected = GpuError::ImageSize { width: 16_384, height: 8, allowed: 8192 };
    assert_eq!(error, expected);
    // It works on.
    gpu.render(&camera(16, 8, [0.0; 3], [1.0, 0.0, 0.0])).unwrap();
}

#[test]
fn a_choice_prepares_on_what_was_asked_for() {
    let Some(device) = device() else { return };
    let cam = camera(64, 48, [0.7, -0.5, 1.1], [0.0, 0.0, 0.75]);
    let cpu = Choice::take(Request::Cpu, Software::Allowed).unwrap();
    assert!(cpu.to_string().starts_with("cpu ("), "{cpu}");
    let scene = tabletop(3, 8);
    let expected = Renderer::new(scene.clone(), &plain()).unwrap();
    let prepared = cpu.prepare(scene.clone(), &plain()).unwrap();
    assert!(matches!(prepared, Backend::Cpu(_)));
    assert!(prepared.render(&cam).unwrap() == expected.render(&cam));
    assert_eq!((prepared.ids(), prepared.amodal_all(&cam).unwrap()), (expected.ids(), expected.amodal_all(&cam)));
    let gpu = Choice::take(Request::Gpu, Software::Allowed).unwrap();
    assert_eq!(gpu.to_string(), format!("gpu ({})", device.name()));
    let prepared = gpu.prepare(scene, &plain()).unwrap();
    assert!(matches!(prepared, Backend::Gpu(_)));
    assert_eq!(prepared.ids(), expected.ids());
    let frame = prepared.render(&cam).unwrap();
    assert_eq!(prepared.depth_ids(&cam).unwrap(), (frame.depth, frame.instance));
}

/// Runs itself in a process that finds no driver.
#[test]
fn without_a_driver_the_error_says_so() {
    const CHILD: &str = "FUSE_TEST_WITHOUT_DRIVER";
    if std::env::var_os(CHILD).is_some() {
        let error = Choice::take(Request::Gpu, Software::Allowed).unwrap_err();
        assert_eq!(error, GpuError::NoAdapter);
        assert!(matches!(Choice::take(Request::Auto, Software::Allowed).unwrap(), Choice::Cpu));
        return;
    }
    if device().is_none() || !cfg!(target_os = "linux") {
        return;
    }
    let status = std::process::Command::new(std::env::current_exe().unwrap())
        .args(["--exact", "without_a_driver_the_error_says_so"])
        .envs([(CHILD, "1"), ("VK_DRIVER_FILES", "/nonexistent"), ("VK_ICD_FILENAMES", "/nonexistent")])
        .status()
        .unwrap();
    assert!(status.success());
}
