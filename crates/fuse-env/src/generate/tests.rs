//! On the shipped objects and scenes.

use std::io::Write;
use std::path::{Path, PathBuf};
use std::sync::OnceLock;

use glam::{Affine3A, Vec3};
use parry3d::math::Pose as Isometry;
use parry3d::shape::TriMesh;

use super::*;
use crate::episode;
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

fn made() -> &'static Episode {
    static MADE: OnceLock<Episode> = OnceLock::new();
    MADE.get_or_init(|| {
        let (validity, request) = cut();
        episode(stage(), &validity, &request).unwrap().0
    })
}

fn trimesh(id: &str, transform: Affine3A) -> TriMesh {
    let model = stage().model(id).unwrap();
    let (mut vertices, mut triangles) = (Vec::<parry3d::math::Vec3>::new(), vec![]);
    for mesh in &model.meshes {
        let first = vertices.len() as u32;
        vertices.extend(
            mesh.positions.iter().map(|p| parry3d::math::Vec3::from(transform.transform_point3(*p).to_array())),
        );
        triangles.extend(mesh.triangles.iter().map(|t| t.map(|i| i + first)));
    }
    TriMesh::new(vertices, triangles).unwrap()
}

#[test]
fn an_episode_keeps_its_promises() {
    let e = made();
    e.validate(stage().catalogue(), stage().scenes()).unwrap();
    let (validity, request) = cut();
    assert_eq!(e, &episode(stage(), &validity, &request).unwrap().0, "the same seed, another episode");

    // The full renderer agrees with the statistics about the start.
    let world = World::load(e, stage()).unwrap();
    let start = e.start().unwrap();
    let frame = world.render(start).unwrap();
    let visible = frame.instance.as_slice().iter().filter(|id| **id == e.target).count() as u32;
    assert_eq!(visible, e.statistics[0].visible_px[start.index()]);
    assert!((0.05..=0.6).contains(&e.statistics[0].fraction(start)));
    assert!(e.statistics[0].well_seen(500, 0.8));
}

#[test]
fn things_rest_on_the_table_and_do_not_touch() {
    let table = &stage().scene("dev_kitchen").unwrap().table;
    let e = made();
    let shapes: Vec<TriMesh> = e.objects.iter().map(|o| trimesh(&o.model_id, o.transform())).collect();
    for (a, o) in shapes.iter().zip(&e.objects) {
        let low = a.vertices().iter().map(|v| v.z).fold(f32::MAX, f32::min);
        assert!((low - table.height_m).abs() < 1e-4, "{} rests at {low}", o.model_id);
        let half = Vec3::new(table.size_m[0], table.size_m[1], 2.0) / 2.0;
        assert!(a.vertices().iter().all(|v| (v.x / half.x).powi(2) + (v.y / half.y).powi(2) < 1.0));
    }
    for (i, a) in shapes.iter().enumerate() {
        for (j, b) in shapes.iter().enumerate().skip(i + 1) {
            // Lifted a little: faces in one plane confuse the judge's triangle test.
            let lifted = Isometry::from_parts([0.0, 0.0, 0.0007].into(), Default::default());
            let gap = parry3d::query::distance(&Isometry::IDENTITY, a, &lifted, b).unwrap().distance;
            assert!(gap > 0.002, "{} and {} are {gap} m apart", e.objects[i].model_id, e.objects[j].model_id);
        }
    }
}

#[test]
fn broken_episodes_are_refused_by_name() {
    let complaint = |change: &dyn Fn(&mut Episode)| {
        let mut e = made().clone();
        change(&mut e);
        e.validate(stage().catalogue(), stage().scenes()).unwrap_err().to_string()
    };
    assert!(complaint(&|e| e.objects[0].model_id = "knife_dev_9".into()).contains("unknown object `knife_dev_9`"));
    assert!(complaint(&|e| e.start_node = 36).contains("node 36"));
    assert!(complaint(&|e| e.target = 99).contains("target 99 is not among the objects"));
    assert!(complaint(&|e| e.scene_id = "dev_attic".into()).contains("unknown scene `dev_attic`"));
    assert!(complaint(&|e| e.distractor_ids.truncate(3)).contains("distractor_ids"));
    assert!(complaint(&|e| e.statistics[0].visible_px.clear()).contains("108 views"));

    let folder = std::env::temp_dir().join(format!("fuse-episodes-{}", std::process::id()));
    std::fs::create_dir_all(&folder).unwrap();
    let path = folder.join("e.json.gz");
    episode::write(&path, std::slice::from_ref(made())).unwrap();
    assert_eq!(episode::read(&path).unwrap(), [made().clone()]);
    let bytes = std::fs::read(&path).unwrap();
    std::fs::write(&path, &bytes[..bytes.len() / 2]).unwrap();
    assert!(episode::read(&path).unwrap_err().to_string().contains("not a complete gzip file"));
    for (text, reason) in [
        (&b"[]"[..], "expected an object with `schema_version` and `episodes`"),
        (b"\xff\xfe", "is not an episode file: expected value"),
        (b"{\"schema_version\": 7, \"episodes\": []}", "e.json.gz has schema version 7, expected 1"),
        (&vec![b' '; (512 << 20) + 1], "unpacks to more than 512 MiB"),
    ] {
        let mut encoder = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::fast());
        encoder.write_all(text).unwrap();
        std::fs::write(&path, encoder.finish().unwrap()).unwrap();
        let error = episode::read(&path).unwrap_err().to_string();
        assert!(error.contains(reason), "{error}");
    }
    std::fs::remove_dir_all(&folder).unwrap();

    let newer = serde_json::to_string(made()).unwrap().replacen("\"schema_version\":1", "\"schema_version\":2", 1);
    assert!(Episode::from_json(&newer).unwrap_err().to_string().contains("schema version 2, expected 1"));
}

#[test]
fn unknown_verbs_and_impossible_targets_are_told_apart() {
    let (validity, mut request) = cut();
    request.verb = "fly".into();
    assert!(
        episode(stage(), &validity, &request).unwrap_err().to_string().contains("unknown verb `fly`; known verbs: cut")
    );
    let exhausted = GenerateError::Exhausted {
        verb: "pour".into(),
        scene: "dev_study".into(),
        seed: 3,
        rejections: Rejections::from([("no room on the table", 4), (NOT_HIDDEN, 56)]),
    };
    assert_eq!(
        exhausted.to_string(),
        "no episode for `pour` in scene `dev_study` with seed 3: 60 layouts were thrown away (no view where the \
         target is partly hidden: 56, no room on the table: 4); another seed or scene may have one"
    );
    let none = Validity::from([("fly".to_owned(), vec![])]);
    assert!(matches!(episode(stage(), &none, &request), Err(GenerateError::NoTarget { .. })));
}
