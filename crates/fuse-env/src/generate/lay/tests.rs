//! On the shipped objects.

use std::path::Path;
use std::sync::OnceLock;

use rand::SeedableRng;
use rapier3d::glamx::{DVec3, Vec3};
use rayon::prelude::*;

use super::*;
use crate::catalogue::Split;
use crate::difficulty::Difficulty;
use crate::generate::Validity;
use crate::generate::choose::choose;
use crate::objects::hull::Hull;
use crate::placement::check::{PENETRATION_M, penetration};
use crate::placement::compound::TOLERANCE;
use crate::placement::layout::Hold;
use crate::placement::settle::{drift, pose};
use crate::placement::solid::Solid;
use crate::placement::units::PER_METRE;

const STYLES: [ClutterStyle; 6] = [
    ClutterStyle::Sparse,
    ClutterStyle::Packed,
    ClutterStyle::Stacked,
    ClutterStyle::Leaning,
    ClutterStyle::InContainers,
    ClutterStyle::OnTray,
];

fn stage() -> &'static Stage {
    static STAGE: OnceLock<Stage> = OnceLock::new();
    STAGE.get_or_init(|| {
        let data = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../python/fuse_grounding/data");
        Stage::load(&data.join("objects"), &data.join("scenes.json")).unwrap()
    })
}

/// Lays things out in a style on the kitchen's table for the first of some seeds that works; returns
/// what shall hold them and where they came to rest.
fn laid(style: ClutterStyle, ids: &[&str]) -> (Vec<Option<Hold>>, Vec<Pose>) {
    let records: Vec<_> = ids.iter().map(|id| stage().catalogue().get(id).unwrap()).collect();
    let surface = Surface::of(stage().scene("dev_kitchen").unwrap());
    for seed in 0..8 {
        let found = with_things(stage(), &records, |things| {
            settled(style, things, &surface, &mut ChaCha8Rng::seed_from_u64(seed)).map(|(p, poses)| (p.holds, poses))
        });
        if let Ok(Ok(found)) = found {
            return found;
        }
    }
    panic!("no layout of {ids:?} in eight");
}

#[test]
fn a_spoon_stands_in_a_mug() {
    let (holds, poses) = laid(ClutterStyle::InContainers, &["mug_dev_0", "spoon_dev_0"]);
    assert_eq!(holds, [None, Some(Hold::In(0))]);
    let (mug, spoon) = (stage().solid("mug_dev_0").unwrap(), stage().solid("spoon_dev_0").unwrap());
    let cavity = mug.cavity.unwrap();
    let in_mug: Vec<Vec3> = spoon.samples.iter().map(|p| poses[0].inv_mul(&poses[1]).transform_point(*p)).collect();
    let low = in_mug.iter().min_by(|a, b| a.z.total_cmp(&b.z)).unwrap();
    let high = in_mug.iter().map(|p| p.z).fold(f32::MIN, f32::max);
    let off = (low.x - cavity.axis.x).hypot(low.y - cavity.axis.y);
    assert!(off < cavity.radius + 0.004 && low.z < cavity.floor + 0.02, "its end is {off} m off at {}", low.z);
    assert!(high > cavity.rim + 0.03, "its tip is at {high}, the rim at {}", cavity.rim);
}

#[test]
fn a_plate_carries_a_cup() {
    let (holds, poses) = laid(ClutterStyle::Stacked, &["plate_dev_0", "mug_dev_0"]);
    assert_eq!(holds, [None, Some(Hold::On(0))]);
    let height = stage().scene("dev_kitchen").unwrap().table.height_m;
    let mug = stage().solid("mug_dev_0").unwrap();
    let lowest = mug.samples.iter().map(|p| poses[1].transform_point(*p).z).fold(f32::MAX, f32::min);
    assert!((0.003..0.03).contains(&(lowest - height)), "the mug is {} m above the table", lowest - height);
    let apart = (poses[0].translation - poses[1].translation).truncate().length();
    assert!(apart < 0.12, "{apart} m from the plate's middle");
}

#[test]
fn every_style_gives_sound_layouts_at_rest_whatever_the_threads() {
    let verbs = Validity::from([("hold".to_owned(), vec![crate::catalogue::Category::Sponge])]);
    let lay_one = |style: ClutterStyle, seed: u64| {
        let mut scene = stage().scene("dev_kitchen").unwrap().clone();
        scene.clutter.style = style;
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let records = choose(stage(), &scene, &verbs, "hold", &Difficulty::default(), true, &mut rng).unwrap();
        lay(stage(), &scene, records, &mut rng).unwrap()
    };
    let jobs: Vec<(ClutterStyle, u64)> = STYLES.into_iter().flat_map(|s| (0..8).map(move |i| (s, i))).collect();
    let run = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| jobs.par_iter().map(|(style, seed)| lay_one(*style, *seed)).collect::<Vec<_>>())
    };
    let layouts = run(3);
    assert_eq!(layouts, run(1), "another number of threads, another layout");

    let scene = stage().scene("dev_kitchen").unwrap();
    let top = Top { outline: Surface::of(scene).outline, height: scene.table.height_m };
    for style in STYLES {
        let sound: Vec<_> = jobs
            .iter()
            .zip(&layouts)
            .filter(|(j, l)| j.0 == style && l.is_ok())
            .flat_map(|(_, l)| l.as_ref())
            .collect();
        assert!(sound.len() >= 2, "{style:?}: {} of 8 layouts", sound.len());
        for objects in sound {
            let solids: Vec<_> = objects.iter().map(|o| stage().solid(&o.model_id).unwrap()).collect();
            let things: Vec<(&Solid, Pose)> = solids.iter().zip(objects).map(|(s, o)| (s.as_ref(), posed(o))).collect();
            for (i, a) in things.iter().enumerate() {
                let low = a.0.samples.iter().map(|p| a.1.transform_point(*p).z).fold(f32::MAX, f32::min);
                assert!(low > top.height - PENETRATION_M, "{style:?}: {} reaches down to {low}", objects[i].model_id);
                for b in &things[i + 1..] {
                    let deep = penetration(*a, *b, 1.0);
                    assert!(deep <= PENETRATION_M, "{style:?}: {deep} m deep in {}", objects[i].model_id);
                }
            }
            let moved = drift(&top, &things, 1.0);
            assert!(moved < 0.004, "{style:?}: something moves by {moved} m within a second");
        }
    }
}

fn posed(o: &EpisodeObject) -> Pose {
    let t = o.transform();
    let (_, rotation, translation) = t.to_scale_rotation_translation();
    pose(rotation, translation)
}

/// What keeps things apart is the pieces: what sticks out of them would go into other things. Judged by hulls of the
/// pieces' points with exact predicates, not by the engine.
#[test]
fn pieces_hold_their_meshes() {
    let records: Vec<_> =
        [Split::Train, Split::Dev, Split::Eval].iter().flat_map(|s| stage().catalogue().of(*s)).collect();
    let worst = |record: &&ObjectRecord| {
        let solid = stage().solid(&record.id).unwrap();
        let hulls: Vec<Vec<(DVec3, f64)>> = solid.polyhedra().map(|points| planes(&points)).collect();
        let outside = |p: DVec3| {
            let least = |found: f64, planes: &Vec<(DVec3, f64)>| {
                planes.iter().map(|(normal, offset)| normal.dot(p) - offset).fold(f64::MIN, f64::max).min(found)
            };
            hulls.iter().fold(f64::MAX, least)
        };
        solid.samples.iter().map(|p| outside(p.as_dvec3())).fold(0.0, f64::max)
    };
    let off: Vec<f64> = records.par_iter().map(worst).collect();
    for (record, off) in records.iter().zip(off) {
        assert!(off < f64::from(TOLERANCE) + 2e-5, "{}: the mesh sticks {off} m out of its pieces", record.id);
    }
}

/// Outward normals and offsets of the hull of some points.
fn planes(points: &[Vec3]) -> Vec<(DVec3, f64)> {
    let hull = Hull::new(points.iter().map(|p| glam::Vec3::from_array(p.to_array()))).unwrap();
    let plane = |f: &[usize; 3]| {
        let normal = DVec3::from_array(hull.plane(*f).0.to_array());
        (normal, normal.dot(DVec3::from_array(hull.points[f[0]].to_array())))
    };
    hull.faces.iter().map(plane).collect()
}

#[test]
fn vessels_stay_hollow() {
    let vessels = ["mug", "bowl", "pitcher", "measuring_cup", "wine_glass", "plate", "tray", "colander"];
    for record in stage().catalogue().of(Split::Dev) {
        let solid = stage().solid(&record.id).unwrap();
        if !vessels.contains(&record.category.id()) {
            continue;
        }
        let c = solid.cavity.unwrap_or_else(|| panic!("{} has no cavity", record.id));
        for (part, height) in [(0.0, 0.15), (0.0, 0.5), (0.0, 0.9), (0.7, 0.5), (0.7, 0.9)] {
            for (x, y) in [(1.0, 0.0), (-0.6, 0.8), (0.0, -1.0)] {
                let at = Vec3::new(c.axis.x + part * c.radius * x, c.axis.y + part * c.radius * y, 0.0)
                    + Vec3::Z * (c.floor + height * (c.rim - c.floor));
                assert!(!solid.compound.contains_local_point(at * PER_METRE), "{} is filled at {at}", record.id);
            }
        }
    }
}
