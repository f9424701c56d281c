//! On the shipped objects and scenes.

use std::io::Write;
use std::path::{Path, PathBuf};
use std::sync::OnceLock;

use super::*;
use crate::episode::{self, EpisodeSet, Witness};
use crate::world::World;

fn data() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../python/fuse_grounding/data")
}

fn stage() -> &'static Stage {
    static STAGE: OnceLock<Stage> = OnceLock::new();
    STAGE.get_or_init(|| {
        let mut scenes = crate::configuration::load(&data().join("scenes.json")).unwrap();
        for s in &mut scenes {
            let (r, t) = (&mut s.room, &mut s.table);
            for surface in [&mut r.floor, &mut r.wall, &mut r.wood, &mut t.top, &mut t.frame] {
                surface.texels = 64;
            }
        }
        Stage::new(crate::catalogue::Catalogue::load(data().join("objects")).unwrap(), scenes)
    })
}

fn cut() -> (Validity, Request) {
    let validity = Validity::from([("cut".to_owned(), vec![Category::Knife, Category::Scissors])]);
    let request = Request {
        scene: "dev_kitchen".into(),
        verb: "cut".into(),
        query: "cut a piece of rope".into(),
        seed: 5,
        episode_id: "dev_0005".into(),
    };
    (validity, request)
}

fn made() -> &'static Made {
    static MADE: OnceLock<Made> = OnceLock::new();
    MADE.get_or_init(|| {
        let (validity, request) = cut();
        episode(stage(), &validity, &request, &Difficulty::default()).unwrap()
    })
}

#[test]
fn an_episode_keeps_its_promises() {
    let Made { episode: e, statistics, .. } = made();
    e.validate(stage().catalogue(), stage().scenes()).unwrap();
    e.check_statistics(statistics).unwrap();
    let (validity, request) = cut();
    let again = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
    let again = again.install(|| episode(stage(), &validity, &request, &Difficulty::default()).unwrap());
    assert_eq!(made(), &again, "the same seed, another episode");
    assert_eq!(&stage().statistics(e).unwrap(), statistics, "counted anew, other statistics");

    // The full renderer agrees with the statistics about the start, and its amodal counts with those of the
    // object alone.
    let world = World::load(e, stage()).unwrap();
    let (start, best) = (e.start().unwrap(), e.best().unwrap());
    let frame = world.render(start).unwrap();
    let visible = frame.instance.as_slice().iter().filter(|id| **id == e.target).count() as u32;
    assert_eq!((visible, visible), (statistics[0].visible_px[start.index()], e.start_px));
    let scene = stage().scene(&e.scene_id).unwrap();
    let whole = stage().renderer(scene, &e.objects, false).unwrap();
    for view in [start, best] {
        let amodal = whole.amodal(&Ring::of(scene).camera(view), e.target);
        let counted = (statistics[0].visible_px[view.index()], statistics[0].unoccluded_px[view.index()]);
        assert_eq!((amodal.visible_px, amodal.unoccluded_px), counted);
    }
    assert!((0.05..=0.6).contains(&e.start_fraction));
    assert!(statistics[0].well_seen(best, 500, 0.8));
}

#[test]
fn broken_episodes_are_refused_by_name() {
    let complaint = |change: &dyn Fn(&mut Episode)| {
        let mut e = made().episode.clone();
        change(&mut e);
        e.validate(stage().catalogue(), stage().scenes()).unwrap_err().to_string()
    };
    assert!(complaint(&|e| e.objects[0].model_id = "knife_dev_9".into()).contains("unknown object `knife_dev_9`"));
    assert!(complaint(&|e| e.start_node = 36).contains("node 36"));
    assert!(complaint(&|e| e.target = 99).contains("target 99 is not among the objects"));
    assert!(complaint(&|e| e.scene_id = "dev_attic".into()).contains("unknown scene `dev_attic`"));
    assert!(complaint(&|e| e.distractor_ids.truncate(3)).contains("distractor_ids"));
    assert!(complaint(&|e| e.start_fraction = 0.7).contains("the start view shows 0.700"));
    assert!(complaint(&|e| e.best_px = 499).contains("499 pixels, expected at least 0.8 and 500"));
    assert!(complaint(&|e| e.moves_to_good_view = 31).contains("1 to 30, found 31"));
    assert!(complaint(&|e| e.query = "x".repeat(201)).contains("1 to 200 bytes, found 201"));
    let newer =
        serde_json::to_string(&made().episode).unwrap().replacen("\"schema_version\":2", "\"schema_version\":1", 1);
    assert!(Episode::from_json(&newer).unwrap_err().to_string().contains("schema version 1, expected 2"));
}

#[test]
fn statistics_that_do_not_fit_are_refused() {
    let complaint = |change: &dyn Fn(&mut Vec<TargetStatistics>)| {
        let mut statistics = made().statistics.clone();
        change(&mut statistics);
        made().episode.check_statistics(&statistics).unwrap_err().to_string()
    };
    assert!(complaint(&|s| s.clear()).contains("one to one"));
    assert!(complaint(&|s| s[0].visible_px.truncate(3)).contains("must have 108 views, found [3, 108, 108]"));
    assert!(complaint(&|s| s[0].pixels_max += 1).contains("pixels_max"));
    assert!(complaint(&|s| s[0].visible_fraction[7] += 0.5).contains("view 7 shows"));
    assert!(complaint(&|s| s[0].position_m[2] = f64::NAN).contains("finite"));
    let start = made().episode.start().unwrap().index();
    let fewer = complaint(&|s| {
        s[0].unoccluded_px[start] *= 2;
        s[0].visible_fraction[start] =
            (f64::from(s[0].visible_px[start]) / f64::from(s[0].unoccluded_px[start]) * 1e4).round() / 1e4;
    });
    assert!(fewer.contains("start: the episode says"), "{fewer}");
}

#[test]
fn files_are_whole_tied_together_and_alike() {
    let folder = tempfile::tempdir().unwrap();
    let (path, other) = (folder.path().join("e.json.gz"), folder.path().join("o.json.gz"));
    let set = |id: &str| {
        let episode = Episode { episode_id: id.into(), ..made().episode.clone() };
        EpisodeSet { schema_version: 2, generation: None, episodes: vec![episode] }
    };
    let witness = |id: &str| Witness { episode_id: id.into(), targets: made().statistics.clone() };
    episode::write(&path, &set("a")).unwrap();
    episode::write(&other, &set("b")).unwrap();
    assert_eq!(episode::read(&path).unwrap(), set("a"));
    let sidecar = episode::statistics_path(&path);
    assert_eq!(sidecar, folder.path().join("e.statistics.json.gz"));
    episode::write_statistics(&sidecar, &path, &[witness("a")]).unwrap();
    assert_eq!(episode::read_statistics(&sidecar, &path).unwrap(), [witness("a")]);
    let foreign = episode::read_statistics(&sidecar, &other).unwrap_err().to_string();
    assert!(foreign.contains("belongs to another episode file: it names SHA-256"), "{foreign}");
    episode::write_statistics(&sidecar, &path, &[witness("b")]).unwrap();
    assert!(episode::read_statistics(&sidecar, &path).unwrap_err().to_string().contains("one to one"));

    let bytes = std::fs::read(&path).unwrap();
    assert_eq!(bytes[3..8], [0; 5], "the gzip header holds no name and no time");
    episode::write(&path, &set("a")).unwrap();
    assert_eq!(bytes, std::fs::read(&path).unwrap());
    std::fs::write(&path, &bytes[..bytes.len() / 2]).unwrap();
    assert!(episode::read(&path).unwrap_err().to_string().contains("not a complete gzip file"));
    for (text, reason) in [
        (&b"[]"[..], "expected an object with `schema_version`, `generation` and `episodes`"),
        (b"\xff\xfe", "is not an episode file: expected value"),
        (b"{\"schema_version\": 1, \"episodes\": []}", "e.json.gz has schema version 1, expected 2"),
        (b"{\"schema_version\": 2, \"generation\": {}, \"episodes\": []}", "missing field `set`"),
        (&vec![b' '; (512 << 20) + 1], "unpacks to more than 512 MiB"),
    ] {
        let mut encoder = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::fast());
        encoder.write_all(text).unwrap();
        std::fs::write(&path, encoder.finish().unwrap()).unwrap();
        let error = episode::read(&path).unwrap_err().to_string();
        assert!(error.contains(reason), "{error}");
    }
}

/// Verbs and scenes come evenly, and a longer set begins like a shorter one.
#[test]
fn requests_are_even() {
    let queries: BTreeMap<String, Vec<String>> =
        ["cut", "pour", "wipe"].map(|v| (v.to_owned(), vec![format!("{v} it"), format!("please {v}")])).into();
    let of = |count| requests(stage().scenes(), "some", Split::Dev, &queries, count, 9);
    let made = of(31);
    assert_eq!(made[..10], of(10)[..]);
    let times = |pick: &dyn Fn(&Request) -> bool| made.iter().filter(|r| pick(r)).count();
    for verb in queries.keys() {
        assert!((10..=11).contains(&times(&|r| &r.verb == verb)), "{verb}");
    }
    let scenes: std::collections::BTreeSet<&str> = made.iter().map(|r| r.scene.as_str()).collect();
    assert!(scenes.iter().all(|s| times(&|r| r.scene == *s).abs_diff(31 / scenes.len()) <= 1));
    assert_eq!((made[30].episode_id.as_str(), times(&|r| r.query.contains(&r.verb))), ("some_0030", 31));
}

#[test]
fn unknown_verbs_and_impossible_targets_are_told_apart() {
    let (validity, mut request) = cut();
    request.verb = "fly".into();
    assert!(
        episode(stage(), &validity, &request, &Difficulty::default())
            .unwrap_err()
            .to_string()
            .contains("unknown verb `fly`; known verbs: cut")
    );
    let exhausted = GenerateError::Exhausted {
        verb: "pour".into(),
        scene: "train_study".into(),
        seed: 3,
        rejections: Rejections::from([("no room on the table", 4), (NOT_HIDDEN, 56)]),
    };
    assert_eq!(
        exhausted.to_string(),
        "no episode for `pour` in scene `train_study` with seed 3: 60 layouts were thrown away (no view that \
         hides the target enough: 56, no room on the table: 4); another seed or scene may have one"
    );
    let none = Validity::from([("fly".to_owned(), vec![])]);
    assert!(matches!(episode(stage(), &none, &request, &Difficulty::default()), Err(GenerateError::NoTarget { .. })));
}
