//! The fast renderer against the f64 reference, SIMD levels against one another, and threads.

mod scene;

use fuse_camera::simd::{Level, best};
use fuse_splat::{Gaussians, Trainer, TrainerConfig, reference, render_at};

fn vectors(gaussians: &Gaussians) -> Vec<[f64; 59]> {
    (0..gaussians.len()).map(|i| gaussians.vector(i).map(f64::from)).collect()
}

/// Thin, fat, faint, opaque, behind the camera, at the image's border.
fn crowd() -> Gaussians {
    scene::cloud(700, 3, 1.4, [0.002, 0.12], [-4.0, 5.0])
}

#[test]
fn fast_and_reference_agree_on_all_but_one_pixel_in_a_thousand() {
    let (gaussians, background) = (crowd(), [0.2, 0.5, 0.9]);
    for (width, height, angle) in [(161, 119, 0.0), (96, 64, 2.0)] {
        let camera = scene::camera(width, height, angle);
        let slow = reference::render(&vectors(&gaussians), &camera, 3, background.map(f64::from));
        for level in [Level::Portable, Level::Avx2Fma, best()] {
            let fast = render_at(level, &gaussians, &camera, background).unwrap();
            let n = slow.color.len();
            let far = |error: f64| error > 1.0 / 255.0;
            let color = (0..n).filter(|&i| {
                (0..3).any(|c| far((f64::from(fast.color.as_slice()[i][c]) - slow.color[i][c].min(1.0)).abs()))
            });
            let alpha =
                (0..n).filter(|&i| far((f64::from(fast.alpha.as_slice()[i]) - 1.0 + slow.transmittance[i]).abs()));
            let depth = (0..n).filter(|&i| {
                let alpha = 1.0 - slow.transmittance[i];
                alpha > 0.1 && far((f64::from(fast.depth.as_slice()[i]) - slow.depth[i] / alpha).abs())
            });
            let wrong = [color.count(), alpha.count(), depth.count()];
            println!("{} {width}x{height}: {wrong:?} of {n} pixels differ", level.name());
            assert!(wrong.iter().all(|&w| w * 1000 <= n), "{wrong:?} of {n} pixels differ by more than 1/255");
            let drawn = slow.transmittance.iter().filter(|&&t| t < 0.5).count();
            assert!(drawn * 3 > n, "the scene must cover the picture, covers {drawn} of {n}");
        }
    }
}

#[test]
fn nothing_to_draw_shows_the_background() {
    let behind = Gaussians::from_points(&[[2.2, 0.0, 1.4]], &[[1.0, 0.0, 0.0]]).unwrap();
    for gaussians in [Gaussians::default(), behind] {
        let r = fuse_splat::render(&gaussians, &scene::camera(50, 40, 0.0), [0.25, 0.5, 0.75]).unwrap();
        assert!(r.color.as_slice().iter().all(|p| *p == [0.25, 0.5, 0.75]));
        assert!(r.alpha.as_slice().iter().chain(r.depth.as_slice()).all(|&v| v == 0.0));
    }
}

#[test]
fn absurd_gaussians_neither_panic_nor_spread() {
    let mut gaussians = scene::cloud(40, 8, 0.3, [0.02, 0.1], [0.0, 2.0]);
    for (i, (row, value)) in
        [(0, 1e30), (3, 80.0), (4, -80.0), (6, 0.0), (10, 500.0), (10, -500.0), (20, 1e20), (2, f32::NAN)]
            .into_iter()
            .enumerate()
    {
        gaussians.set(i, row, value);
    }
    for k in 0..4 {
        gaussians.set(9, 6 + k, 0.0);
    }
    let r = fuse_splat::render(&gaussians, &scene::camera(64, 48, 1.0), [0.0; 3]).unwrap();
    assert_eq!(r.color.as_slice().len(), 64 * 48);
}

/// Training to the last bit: densification and reset included.
fn trained(threads: usize, level: Level) -> (Gaussians, f64) {
    let truth = scene::cloud(60, 11, 0.35, [0.03, 0.12], [0.0, 4.0]);
    let config = TrainerConfig {
        densify_start: 10,
        densify_interval: 15,
        opacity_reset_interval: 40,
        opacity_reset_margin: 0,
        degree_interval: 20,
        seed: 4,
        ..TrainerConfig::default()
    };
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
    pool.install(|| {
        let start = scene::cloud(2000, 12, 0.35, [0.02, 0.08], [-2.0, 0.0]);
        let mut trainer = Trainer::with_level(level, start, config).unwrap();
        for angle in [0.0, 0.5] {
            let camera = scene::camera(150, 140, angle);
            trainer.add_view(&scene::picture(&truth, &camera), &camera).unwrap();
        }
        let stats = trainer.refine(60).unwrap();
        (trainer.gaussians(), stats.loss)
    })
}

#[test]
fn any_number_of_threads_gives_the_same_bits() {
    let one = trained(1, best());
    for threads in [2, 3] {
        assert!(trained(threads, best()) == one, "{threads} threads differ from one");
    }
}

#[test]
fn levels_agree() {
    let (gaussians, camera) = (crowd(), scene::camera(161, 119, 0.0));
    let a = render_at(Level::Portable, &gaussians, &camera, [0.0; 3]).unwrap();
    let b = render_at(best(), &gaussians, &camera, [0.0; 3]).unwrap();
    let pairs = a.color.as_slice().iter().flatten().zip(b.color.as_slice().iter().flatten());
    let apart = pairs.filter(|(x, y)| (**x - **y).abs() > 2e-3).count();
    assert!(apart * 1000 <= 3 * 161 * 119, "{apart} values differ by more than 2e-3");
}
