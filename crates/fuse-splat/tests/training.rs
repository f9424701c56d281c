//! Training on views of a known scene.

mod scene;

use fuse_splat::{Gaussians, Trainer, TrainerConfig, psnr, quality, render};

fn held_out_psnr(trained: &Gaussians, truth: &Gaussians, angle: f64) -> f64 {
    let camera = scene::camera(120, 90, angle);
    let flat = |g: &Gaussians| -> Vec<f32> {
        render(g, &camera, [0.0; 3]).unwrap().color.as_slice().iter().flatten().copied().collect()
    };
    psnr(&flat(trained), &flat(truth)).unwrap()
}

fn truth() -> Gaussians {
    scene::cloud(150, 21, 0.35, [0.03, 0.1], [1.0, 4.0])
}

/// Points near the true ones, as a reconstruction would find them.
fn points(truth: &Gaussians) -> (Vec<[f32; 3]>, Vec<[f32; 3]>) {
    let mut r = scene::Random::new(2);
    let xyz = (0..truth.len()).map(|i| truth.position(i).map(|v| v + r.between(-0.01, 0.01))).collect();
    (xyz, vec![[0.5; 3]; truth.len()])
}

fn trainer(config: TrainerConfig) -> Trainer {
    let truth = truth();
    let (xyz, rgb) = points(&truth);
    let mut trainer = Trainer::new(Gaussians::from_points(&xyz, &rgb).unwrap(), config).unwrap();
    for k in 0..6 {
        let camera = scene::camera(120, 90, f64::from(k) * 0.35);
        trainer.add_view(&scene::picture(&truth, &camera), &camera).unwrap();
    }
    trainer
}

#[test]
fn training_lowers_the_loss_and_improves_views_it_has_not_seen() {
    let truth = truth();
    let mut trainer = trainer(TrainerConfig { densify_start: 200, ..TrainerConfig::default() });
    let before = held_out_psnr(&trainer.gaussians(), &truth, 0.52);
    let first = trainer.refine(300).unwrap();
    let middle = held_out_psnr(&trainer.gaussians(), &truth, 0.52);
    let second = trainer.refine(300).unwrap();
    let after = held_out_psnr(&trainer.gaussians(), &truth, 0.52);
    println!("held out {before:.1} → {middle:.1} → {after:.1} dB, {first:?} {second:?}");
    assert!(first.loss < 0.5 * first.loss_first && second.loss < first.loss);
    assert!(middle > before + 5.0 && after > middle + 0.5 && after > 24.0);
    assert_eq!((second.total_iterations, trainer.iteration()), (600, 600));
    assert!(second.changes.cloned + second.changes.split > 0, "densification did nothing");
}

#[test]
fn a_start_at_half_the_resolution_ends_as_well() {
    let psnr = |fine_iterations| {
        let mut trainer = trainer(TrainerConfig { fine_iterations, ..TrainerConfig::default() });
        trainer.refine(300).unwrap();
        held_out_psnr(&trainer.gaussians(), &truth(), 0.52)
    };
    let (full, half_first, one_half) = (psnr(None), psnr(Some(120)), psnr(Some(299)));
    println!("{full:.2} dB, half the resolution first {half_first:.2} dB, once {one_half:.2} dB");
    assert!(half_first > full - 1.0);
    assert!(full != one_half && one_half != half_first, "the resolution is not looked at");
}

#[test]
fn a_step_may_stand_for_several_iterations() {
    let config = |step_iterations| TrainerConfig {
        densify_start: 10,
        densify_interval: 20,
        opacity_reset_interval: 40,
        opacity_reset_margin: 0,
        step_iterations,
        ..TrainerConfig::default()
    };
    for (size, steps) in [(1, 100), (3, 34)] {
        let (mut taken, mut trainer) = (0, trainer(config(size)));
        let before = trainer.gaussians().len();
        let mut proceed = || {
            taken += 1;
            true
        };
        let stats = trainer.refine_while(100, 0, &mut proceed).unwrap();
        assert_eq!((taken, stats.iterations, trainer.iteration()), (steps, 100, 100));
        assert_eq!(stats.opacity_resets, 2, "steps of {size}: what is due by iteration comes as often");
        assert!(trainer.gaussians().len() > before && stats.changes.cloned + stats.changes.split > 0);
    }
}

#[test]
fn the_gain_stretches_every_step() {
    let moved = |rate_gain| {
        let mut trainer = trainer(TrainerConfig { rate_gain, ..TrainerConfig::default() });
        let before = trainer.gaussians();
        trainer.refine(1).unwrap();
        let after = trainer.gaussians();
        let change = |row: usize| (0..before.len()).map(|i| after.vector(i)[row] - before.vector(i)[row]).collect();
        [0, 3, 10, 11].map(change)
    };
    // The first step of Adam is the rate, whatever the gradient.
    let (once, thrice): ([Vec<f32>; 4], [Vec<f32>; 4]) = (moved(1.0), moved(3.0));
    for (a, b) in once.iter().zip(&thrice) {
        assert!(a.iter().any(|v| *v != 0.0));
        assert!(a.iter().zip(b).all(|(a, b)| (3.0 * a - b).abs() <= 1e-5 + 0.01 * b.abs()), "{a:?} {b:?}");
    }
}

#[test]
fn a_new_view_is_fitted_sooner_where_it_is_favoured() {
    let camera = scene::camera(120, 90, 2.4);
    let picture = scene::picture(&truth(), &camera);
    let error = |favour_new| {
        let mut trainer = trainer(TrainerConfig { favour_new, ..TrainerConfig::default() });
        trainer.refine(100).unwrap();
        trainer.add_view(&picture, &camera).unwrap();
        trainer.refine(60).unwrap();
        quality(&trainer.gaussians(), &camera, &picture, [0.0; 3]).unwrap().psnr
    };
    let (alike, favoured) = (error(0), error(60));
    println!("new view: {alike:.2} dB, favoured {favoured:.2} dB");
    assert!(favoured > alike + 0.3);
}

#[test]
fn a_call_cut_in_two_is_the_same_call() {
    let config = || TrainerConfig {
        densify_start: 10,
        densify_interval: 20,
        opacity_reset_interval: 40,
        opacity_reset_margin: 0,
        ..TrainerConfig::default()
    };
    let (mut whole, mut parts) = (trainer(config()), trainer(config()));
    whole.refine(70).unwrap();
    for n in [20, 20, 0, 1, 29] {
        parts.refine(n).unwrap();
    }
    assert!(whole.gaussians() == parts.gaussians());
}

#[test]
fn a_reset_waits_for_the_next_call_when_it_could_not_heal() {
    let config = TrainerConfig { opacity_reset_interval: 30, opacity_reset_margin: 20, ..TrainerConfig::default() };
    let mut trainer = trainer(config);
    assert_eq!(trainer.refine(45).unwrap().opacity_resets, 0);
    assert_eq!(trainer.refine(40).unwrap().opacity_resets, 2, "the one that waited, and that of iteration 60");
}

#[test]
fn added_points_are_trained_and_the_guard_holds() {
    let mut trainer = trainer(TrainerConfig { max_gaussians: 160, ..TrainerConfig::default() });
    trainer.refine(5).unwrap();
    let added = trainer.add_points(&[[0.1, 0.1, 0.3]; 30], &[[1.0, 0.0, 0.0]; 30]).unwrap();
    assert_eq!((added, trainer.gaussians().len()), (10, 160));
    let before = trainer.gaussians().vector(155);
    trainer.refine(5).unwrap();
    assert_ne!(trainer.gaussians().vector(155), before);
}

#[test]
fn what_cannot_be_trained_is_refused() {
    let message = |e: fuse_splat::SplatError| e.to_string();
    assert_eq!(
        message(Trainer::new(Gaussians::default(), TrainerConfig::default()).unwrap_err()),
        "training needs at least one Gaussian, found none"
    );
    let mut t = Trainer::new(truth(), TrainerConfig::default()).unwrap();
    assert_eq!(message(t.refine(1).unwrap_err()), "training needs at least one view, found none");
    let camera = scene::camera(64, 48, 0.0);
    let image = fuse_camera::RgbBuffer::filled(32, 48, [0; 3]);
    assert_eq!(message(t.add_view(&image, &camera).unwrap_err()), "the image is 32x48 but its camera is 64x48");
    assert_eq!(message(t.set_camera(3, &camera).unwrap_err()), "view 3 does not exist, there are 0");
    assert_eq!(message(Gaussians::from_points(&[[0.0; 3]], &[]).unwrap_err()), "found 1 points but 0 colours");
}
