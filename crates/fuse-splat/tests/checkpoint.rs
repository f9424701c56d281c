//! Training that was stopped continues as if it had not been.

mod scene;

use fuse_splat::{Gaussians, Trainer, TrainerConfig, quality, ssim};

fn config() -> TrainerConfig {
    // Densification, a reset of the opacities and a rise of the degree fall into 160 iterations.
    TrainerConfig {
        densify_start: 20,
        densify_interval: 15,
        opacity_reset_interval: 70,
        opacity_reset_margin: 40,
        degree_interval: 50,
        fine_iterations: Some(60),
        matched_low_pass: true,
        max_gaussians: 400,
        seed: 5,
        ..TrainerConfig::default()
    }
}

fn trainer(config: TrainerConfig, views: u32) -> Trainer {
    let truth = scene::cloud(80, 21, 0.35, [0.03, 0.1], [1.0, 4.0]);
    let xyz: Vec<_> = (0..truth.len()).map(|i| truth.position(i)).collect();
    let start = Gaussians::from_points(&xyz, &vec![[0.5; 3]; xyz.len()]).unwrap();
    let mut trainer = Trainer::new(start, config).unwrap();
    for k in 0..views {
        let camera = scene::camera(80, 60, f64::from(k) * 0.35);
        trainer.add_view(&scene::picture(&truth, &camera), &camera).unwrap();
    }
    trainer
}

#[test]
fn a_training_cut_anywhere_ends_in_the_same_bits() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("state");
    let mut whole = trainer(config(), 5);
    let stats = whole.refine(160).unwrap();
    assert!(stats.changes.cloned + stats.changes.split > 0 && stats.opacity_resets == 1, "{stats:?}");
    for cut in [1, 35, 73, 120] {
        let mut first = trainer(config(), 5);
        first.refine_while(cut, 160 - cut, &mut || true).unwrap();
        first.save_checkpoint(&path, "note for me").unwrap();
        let mut second = trainer(config(), 5);
        assert_eq!(second.load_checkpoint(&path).unwrap(), "note for me");
        assert_eq!(second.iteration(), cut);
        second.refine(160 - cut).unwrap();
        assert_eq!(second.gaussians(), whole.gaussians(), "cut after {cut}");
        // And the state beyond the parameters.
        second.save_checkpoint(&path, "").unwrap();
        let continued = std::fs::read(&path).unwrap();
        whole.save_checkpoint(&path, "").unwrap();
        assert!(continued == std::fs::read(&path).unwrap(), "cut after {cut}");
    }
}

#[test]
fn a_fork_goes_on_as_its_trainer_would_and_neither_moves_the_other() {
    let mut whole = trainer(config(), 5);
    whole.refine(160).unwrap();
    for cut in [1, 73, 120] {
        let mut first = trainer(config(), 4);
        let camera = scene::camera(80, 60, 4.0 * 0.35);
        let picture = scene::picture(&scene::cloud(80, 21, 0.35, [0.03, 0.1], [1.0, 4.0]), &camera);
        let mut twin = first.fork();
        first.refine(30).unwrap();
        twin.add_view(&picture, &camera).unwrap();
        twin.refine_while(cut, 160 - cut, &mut || true).unwrap();
        let mut second = twin.fork();
        twin.set_camera(0, &scene::camera(80, 60, 0.01)).unwrap();
        twin.refine(20).unwrap();
        second.refine(160 - cut).unwrap();
        assert_eq!(second.gaussians(), whole.gaussians(), "forked after {cut}");
        assert_eq!((first.view_count(), first.iteration()), (4, 30));
    }
}

#[test]
fn a_view_is_as_new_after_a_checkpoint_as_before_and_steps_are_counted_on() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("state");
    let config = || TrainerConfig { favour_new: 30, step_iterations: 3, rate_gain: 2.0, ..config() };
    let grown = |first: u32| {
        let mut trainer = trainer(config(), 4);
        trainer.refine(first).unwrap();
        let camera = scene::camera(80, 60, 1.5);
        let truth = scene::cloud(80, 21, 0.35, [0.03, 0.1], [1.0, 4.0]);
        trainer.add_view(&scene::picture(&truth, &camera), &camera).unwrap();
        trainer
    };
    let mut whole = grown(30);
    whole.refine(120).unwrap();
    for cut in [3, 60] {
        let mut first = grown(30);
        first.refine_while(cut, 120 - cut, &mut || true).unwrap();
        first.save_checkpoint(&path, "").unwrap();
        let mut second = grown(0);
        second.load_checkpoint(&path).unwrap();
        second.refine(120 - cut).unwrap();
        assert_eq!(second.gaussians(), whole.gaussians(), "cut after {cut}");
    }
}

#[test]
fn what_does_not_fit_is_refused_and_changes_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("state");
    let mut first = trainer(config(), 3);
    first.refine(10).unwrap();
    first.save_checkpoint(&path, "").unwrap();
    let message = |mut t: Trainer| {
        let before = t.gaussians();
        let text = t.load_checkpoint(&path).unwrap_err().to_string();
        assert!(t.gaussians() == before && t.iteration() == 0);
        text
    };
    let other = TrainerConfig { scale_rate: 0.5, ..config() };
    assert!(message(trainer(other, 3)).contains("`scale_rate: 0.005` there, `scale_rate: 0.5` here"));
    assert!(message(trainer(config(), 2)).contains("written with 3 views, found 2"));
    let mut moved = trainer(config(), 3);
    moved.set_camera(1, &scene::camera(80, 60, 0.36)).unwrap();
    assert!(message(moved).contains("image or camera of view 1 differs"));

    let whole = std::fs::read(&path).unwrap();
    let put = |bytes: &[u8], part: &str| {
        std::fs::write(&path, bytes).unwrap();
        let text = trainer(config(), 3).load_checkpoint(&path).unwrap_err().to_string();
        assert!(text.contains(part) && text.contains("state"), "{text:?} should contain {part:?}");
    };
    put(b"", "not a checkpoint");
    put(b"ply\n", "not a checkpoint");
    put(&whole[..whole.len() / 2], "damaged or truncated");
    put(&[&whole[..8], &[9, 0, 0, 0], &whole[12..]].concat(), "version 9");
    put(&whole[..14], "truncated");
    let mut flipped = whole.clone();
    flipped[whole.len() / 2] ^= 1;
    put(&flipped, "checksum does not fit");
}

#[test]
fn quality_is_one_for_equal_images_and_falls_with_noise() {
    let truth = scene::cloud(80, 21, 0.35, [0.03, 0.1], [1.0, 4.0]);
    let camera = scene::camera(80, 60, 0.0);
    let picture = scene::picture(&truth, &camera);
    let same = quality(&truth, &camera, &picture, [0.0; 3]).unwrap();
    assert!(same.psnr.is_infinite() && (same.ssim - 1.0).abs() < 1e-5, "{same:?}");
    let mut noisy = picture.clone();
    for (i, p) in noisy.as_mut_slice().iter_mut().enumerate() {
        p[i % 3] = p[i % 3].saturating_add((i * 37 % 41) as u8);
    }
    let less = quality(&truth, &camera, &noisy, [0.0; 3]).unwrap();
    assert!(less.psnr < 35.0 && less.ssim < 0.99, "{less:?}");
    assert!(ssim(&picture, &scene::picture(&truth, &scene::camera(40, 60, 0.0))).is_err());
}
