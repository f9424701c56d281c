use super::*;

#[test]
fn evaluation_is_refused_and_splits_share_no_surface_family_of_table_floor_or_wall() {
    let options = Options { width: 64, height: 48, split: Split::Eval, amodal: false };
    assert!(matches!(pictures(0, 1, &options), Err(RandomizedError::Evaluation)));
    let families = |split| {
        let mut rng = ChaCha8Rng::seed_from_u64(4);
        (0..200)
            .map(|_| random_scene(&mut rng, split))
            .flat_map(|s| [s.table.top.kind, s.room.floor.kind, s.room.wall.kind])
            .fold(Vec::new(), |mut all, kind| {
                if !all.contains(&kind) {
                    all.push(kind);
                }
                all
            })
    };
    let (train, dev) = (families(Split::Train), families(Split::Dev));
    assert_eq!((train.len(), dev.len()), (5, 4));
    assert!(train.iter().all(|kind| !dev.contains(kind)));
}

#[test]
fn the_same_seed_gives_the_same_bits_on_any_number_of_threads() {
    let options = Options { width: 64, height: 48, split: Split::Train, amodal: true };
    let run = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| pictures(8, 3, &options)).unwrap()
    };
    let one = run(1);
    assert_eq!(one, run(3));
    assert!(one.iter().all(|p| p.objects.iter().all(|o| o.unoccluded_px >= o.visible_px)));
    assert!(one.iter().any(|p| p.objects.len() > 3));
}

#[test]
fn paint_changes_looks_and_no_shape_and_leaves_the_marks_of_a_ruler() {
    let mut rng = ChaCha8Rng::seed_from_u64(11);
    let mut marked = 0;
    for seed in 0..30 {
        let before = objects::generate(Category::Ruler, Split::Train, seed).unwrap();
        let after = paint::painted(before.clone(), &mut rng);
        assert_eq!(before.meshes, after.meshes);
        for (old, new) in before.materials.iter().zip(&after.materials).filter(|(old, new)| old != new) {
            assert_eq!(old.name, new.name, "its name stands for a density");
            let (old, new) = (old.base_color_texture.as_ref().unwrap(), new.base_color_texture.as_ref().unwrap());
            // Neighbours along a row: where the old texture steps down sharply, the new one does too, but for
            // where the pattern itself steps up.
            let sum = |texel: [u8; 4]| texel[..3].iter().map(|v| i32::from(*v)).sum::<i32>();
            let at = |of: &fuse_render::Texture, x: u32, y: u32| {
                let (x, y) = (x * of.width / old.width, y * of.height / old.height);
                sum(of.texels[(y * of.width + x) as usize])
            };
            let step = |of: &fuse_render::Texture, x: u32, y: u32| at(of, x + 1, y) - at(of, x, y);
            let sharp: Vec<(u32, u32)> = (0..old.height)
                .flat_map(|y| (0..old.width - 1).map(move |x| (x, y)))
                .filter(|(x, y)| step(old, *x, *y) < -240)
                .collect();
            let kept = sharp.iter().filter(|(x, y)| step(new, *x, *y) < 0).count();
            if sharp.len() > 20 {
                marked += 1;
                assert!(kept * 10 > sharp.len() * 8, "ruler {seed}: {kept} of {} marks are left", sharp.len());
            }
        }
    }
    assert!(marked >= 10, "{marked}");
}
