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
