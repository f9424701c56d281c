//! What every generated thing must satisfy.

use std::collections::{HashMap, HashSet};

use fuse_render::Model;
use glam::{Quat, Vec2, Vec3};

use super::Workshop;
use super::dice::{Families, bands, hues};
use super::hull::Hull;
use super::resting::{centre_of_mass, resting_poses};
use super::sweep::rounded_box;
use super::table::{Stuff, finishes, shapes};
use crate::catalogue::{Category, Split};

fn generate(category: Category, split: Split, seed: u64) -> Model {
    super::generate(category, split, seed).expect("a shipped category has a generator")
}

/// Some instances of every category and split.
fn some() -> impl Iterator<Item = (String, Category, Model)> {
    Category::ALL.iter().flat_map(|&c| {
        Split::ALL.into_iter().flat_map(move |s| (0..3).map(move |i| (format!("{c}_{s}_{i}"), c, generate(c, s, i))))
    })
}

/// All triangles over positions that are equal to the bit.
fn welded(model: &Model) -> (Vec<Vec3>, Vec<[usize; 3]>) {
    let (mut index, mut points) = (HashMap::new(), vec![]);
    let mut triangles = vec![];
    for mesh in &model.meshes {
        let at = |i: u32| mesh.positions[i as usize];
        for t in &mesh.triangles {
            triangles.push(t.map(|i| {
                *index.entry(at(i).to_array().map(|v| (v + 0.0).to_bits())).or_insert_with(|| {
                    points.push(at(i));
                    points.len() - 1
                })
            }));
        }
    }
    (points, triangles)
}

#[test]
fn parts_are_closed_and_wind_outwards() {
    for (name, _, model) in some() {
        let (points, triangles) = welded(&model);
        let mut edges: HashMap<(usize, usize), i32> = HashMap::new();
        let mut parent: Vec<usize> = (0..points.len()).collect();
        fn root(parent: &[usize], mut i: usize) -> usize {
            while parent[i] != i {
                i = parent[i];
            }
            i
        }
        for t in &triangles {
            for k in 0..3 {
                let (a, b) = (t[k], t[(k + 1) % 3]);
                *edges.entry((a.min(b), a.max(b))).or_default() += if a < b { 1 } else { -1 };
                let (ra, rb) = (root(&parent, a), root(&parent, b));
                parent[ra.max(rb)] = ra.min(rb);
            }
        }
        let open = edges.values().filter(|&&n| n != 0).count();
        assert_eq!(open, 0, "{name}: {open} edges are not shared by two faces that agree");
        let mut volumes: HashMap<usize, f32> = HashMap::new();
        for t in &triangles {
            let [a, b, c] = t.map(|i| points[i]);
            *volumes.entry(root(&parent, t[0])).or_default() += a.dot(b.cross(c)) / 6.0;
        }
        for (part, volume) in volumes {
            assert!(volume > 0.0, "{name}: the part around {} has volume {volume} m³", points[part]);
        }
    }
}

#[test]
fn models_are_sound_and_of_moderate_size() {
    for (name, _, model) in some() {
        model.check().unwrap_or_else(|e| panic!("{name}: {e}"));
        let n = model.triangle_count();
        assert!((500..=6000).contains(&n), "{name} has {n} triangles");
        let (low, high) = model.bounds().expect("a generated model has vertices");
        assert!(low.z.abs() < 1e-5, "{name} floats at {}", low.z);
        assert!((low + high).truncate().length() < 1e-4, "{name} is not centred");
    }
}

/// Usual extents in centimetres, longest first.
const USUAL: [(Category, [f32; 3]); 45] = [
    (Category::Knife, [30.0, 4.5, 2.0]),
    (Category::Scissors, [19.0, 10.0, 1.1]),
    (Category::ButterKnife, [20.0, 2.0, 0.7]),
    (Category::Spoon, [19.0, 4.5, 2.2]),
    (Category::Ladle, [31.0, 9.0, 6.5]),
    (Category::Mug, [12.0, 10.0, 8.0]),
    (Category::Bowl, [16.0, 16.0, 6.8]),
    (Category::Pitcher, [21.0, 19.0, 13.0]),
    (Category::WaterBottle, [24.0, 7.0, 7.0]),
    (Category::Teapot, [23.0, 14.0, 13.0]),
    (Category::Marker, [14.0, 2.0, 2.0]),
    (Category::Ruler, [29.0, 3.4, 0.32]),
    (Category::Hammer, [30.0, 12.0, 3.0]),
    (Category::Mallet, [31.0, 12.0, 6.5]),
    (Category::Screwdriver, [21.0, 3.3, 3.2]),
    (Category::Sponge, [10.5, 6.8, 3.0]),
    (Category::Towel, [21.0, 17.0, 3.0]),
    (Category::Book, [21.5, 15.5, 2.8]),
    (Category::BoxCutter, [17.0, 2.5, 1.7]),
    (Category::Fork, [19.0, 2.5, 1.9]),
    (Category::Whisk, [28.0, 6.2, 5.5]),
    (Category::Spatula, [33.0, 8.3, 4.0]),
    (Category::Chopsticks, [23.5, 2.4, 0.85]),
    (Category::Tongs, [29.0, 4.6, 2.3]),
    (Category::MeasuringCup, [13.0, 11.0, 9.5]),
    (Category::WineGlass, [18.5, 7.8, 7.8]),
    (Category::Plate, [23.0, 23.0, 2.0]),
    (Category::Tray, [38.0, 26.0, 5.5]),
    (Category::Colander, [28.0, 23.0, 11.0]),
    (Category::Sieve, [32.0, 15.0, 8.0]),
    (Category::Grater, [22.5, 10.5, 7.5]),
    (Category::RollingPin, [42.0, 5.4, 5.4]),
    (Category::Wrench, [20.0, 4.2, 0.85]),
    (Category::Pliers, [18.0, 6.0, 1.7]),
    (Category::TapeMeasure, [10.0, 6.5, 4.0]),
    (Category::Pen, [14.5, 1.3, 1.1]),
    (Category::Pencil, [17.5, 0.85, 0.85]),
    (Category::Eraser, [5.8, 2.3, 1.3]),
    (Category::ScrubBrush, [19.0, 6.0, 5.2]),
    (Category::Stapler, [14.0, 5.5, 3.5]),
    (Category::BinderClip, [4.2, 3.8, 2.8]),
    (Category::TapeDispenser, [13.5, 8.0, 4.8]),
    (Category::Flashlight, [14.5, 4.2, 4.2]),
    (Category::Candle, [11.5, 8.5, 7.5]),
    (Category::Can, [10.5, 7.2, 7.2]),
];

#[test]
fn sizes_are_those_of_real_things() {
    let usual: HashMap<Category, [f32; 3]> = USUAL.into_iter().collect();
    for (name, category, model) in some() {
        let (low, high) = model.bounds().expect("a generated model has vertices");
        let mut size = (high - low).to_array();
        size.sort_by(|a, b| b.total_cmp(a));
        for (k, (found, expected)) in size.iter().zip(usual[&category]).enumerate() {
            let ratio = found * 100.0 / expected;
            // A rolled towel against a folded one.
            let soft = category == Category::Towel;
            let limit = if soft { [1.7, 2.8, 2.8] } else { [1.7, 1.75, 2.1] }[k];
            assert!((1.0 / limit..limit).contains(&ratio), "{name}: extent {k} is {found} m, usual {expected} cm");
        }
    }
}

#[test]
fn instances_repeat_by_seed_and_differ_between_seeds() {
    for &category in Category::ALL {
        let mut seen: Vec<Model> = vec![];
        for split in Split::ALL {
            for seed in 0..4 {
                let model = generate(category, split, seed);
                assert_eq!(model, generate(category, split, seed), "{category} {split} {seed} is not deterministic");
                for other in &seen {
                    let looks =
                        |m: &Model| m.materials.iter().map(|k| k.base_color_texture.clone()).collect::<Vec<_>>();
                    assert_ne!(model.bounds(), other.bounds(), "{category}: two instances have the same shape");
                    assert_ne!(looks(&model), looks(other), "{category}: two instances have the same textures");
                }
                seen.push(model);
            }
        }
    }
}

#[test]
fn splits_share_no_shape_finish_range_or_hue() {
    let stuffs = [
        Stuff::Steel,
        Stuff::Wood,
        Stuff::Ceramic,
        Stuff::Plastic,
        Stuff::Cloth,
        Stuff::Foam,
        Stuff::Cover,
        Stuff::Label,
    ];
    let tables = Category::ALL.iter().map(|&c| shapes(c)).chain(stuffs.into_iter().map(finishes));
    for table in tables {
        let Families { train, dev, eval } = table;
        let all: Vec<_> = [train, dev, eval].concat();
        assert_eq!(all.iter().collect::<HashSet<_>>().len(), all.len(), "a name is in two splits: {all:?}");
        assert!([train, dev, eval].iter().all(|names| !names.is_empty()));
    }
    for intervals in [bands, hues] {
        let mut all: Vec<(f32, f32)> = Split::ALL.into_iter().flat_map(|s| intervals(s).to_vec()).collect();
        all.sort_by(|a, b| a.0.total_cmp(&b.0));
        assert!(all.windows(2).all(|p| p[0].1 <= p[1].0 + 1e-6), "intervals overlap: {all:?}");
    }
}

#[test]
fn parameters_of_held_out_objects_lie_outside_of_the_training_range() {
    let draw = |split: Split| {
        let mut dice = super::dice::Dice::new(Category::Mug, split, 3);
        (0..2000).map(|_| dice.range(2.0, 4.0)).collect::<Vec<_>>()
    };
    let train = draw(Split::Train);
    let (low, high) = (train.iter().copied().fold(f32::MAX, f32::min), train.iter().copied().fold(f32::MIN, f32::max));
    assert!(low >= 2.3 && high <= 3.7 && high - low > 1.3);
    for split in [Split::Dev, Split::Eval] {
        let drawn = draw(split);
        assert!(drawn.iter().all(|x| (2.0..=4.0).contains(x) && !(low..=high).contains(x)));
        assert!(drawn.iter().any(|x| *x < low) && drawn.iter().any(|x| *x > high));
    }
}

#[test]
fn resting_things_touch_the_table_and_do_not_topple() {
    for (name, category, model) in some() {
        let centre = centre_of_mass(&model).expect("closed solids have mass");
        let poses = resting_poses(&model, category.natural_share());
        let sum: f32 = poses.iter().map(|p| p.probability).sum();
        assert!((sum - 1.0).abs() < 1e-4, "{name}: probabilities sum to {sum}");
        for pose in &poses {
            let place = |p: Vec3| pose.rotation() * p + Vec3::Z * pose.height;
            let points: Vec<Vec3> = model.meshes.iter().flat_map(|m| &m.positions).map(|p| place(*p)).collect();
            let lowest = points.iter().map(|p| p.z).fold(f32::MAX, f32::min);
            assert!(lowest.abs() < 1e-5, "{name}: its lowest point is at {lowest} m");
            // Within the support polygon: no direction in which all contacts lie behind the centre.
            let contacts: Vec<Vec2> = points.iter().filter(|p| p.z < 4e-4).map(|p| p.truncate()).collect();
            let c = place(centre).truncate();
            for k in 0..72 {
                let d = Vec2::from_angle(k as f32 * std::f32::consts::TAU / 72.0);
                let reach = contacts.iter().map(|p| (*p - c).dot(d)).fold(f32::MIN, f32::max);
                assert!(reach > -5e-4, "{name}: topples over by {reach} m towards {d}");
            }
        }
    }
}

/// A solid box, not at the origin.
fn block(size: Vec3) -> Model {
    let mut w = Workshop {
        category: Category::Book,
        dice: super::dice::Dice::new(Category::Book, Split::Train, 0),
        model: Model::default(),
    };
    let stuff = w.material(|_| super::finish::glaze(Vec3::ONE));
    let turn = glam::Mat3::from_quat(Quat::from_rotation_x(0.3));
    w.add(rounded_box(size, 1e-4, 1e-4).turned(turn).moved(Vec3::new(0.02, -0.01, 0.3)), stuff, 30.0);
    w.model
}

#[test]
fn a_cube_rests_on_each_of_its_sides_alike_and_a_plate_mostly_flat() {
    let cube = resting_poses(&block(Vec3::splat(0.06)), 0.5);
    assert_eq!(cube.len(), 6);
    assert!(cube.iter().all(|p| (p.probability - 1.0 / 6.0).abs() < 0.01), "{cube:?}");
    let plate = resting_poses(&block(Vec3::new(0.1, 0.1, 0.02)), 0.5);
    // Seen from the centre a large side covers 4 atan(25 / √51) of the sphere, see van Oosterom.
    let side = 4.0 * (25.0 / 51.0f32.sqrt()).atan() / (4.0 * std::f32::consts::PI);
    assert!((plate[0].probability + plate[1].probability - 2.0 * side).abs() < 0.02, "{plate:?} against {side}");
}

#[test]
fn the_hull_of_a_lattice_is_its_box() {
    let points = (0..1000).map(|i| Vec3::new((i % 10) as f32, (i / 10 % 10) as f32, (i / 100) as f32) * 0.01);
    let hull = Hull::new(points.clone()).expect("a lattice spans a volume");
    let volume: f64 =
        hull.faces.iter().map(|f| f.map(|i| hull.points[i])).map(|[a, b, c]| a.dot(b.cross(c)) / 6.0).sum();
    assert!((volume - 0.09f64.powi(3)).abs() < 1e-7, "{volume}");
    for p in points {
        for &face in &hull.faces {
            let (normal, _) = hull.plane(face);
            assert!(normal.dot(p.as_dvec3() - hull.points[face[0]]) < 4e-6, "{p} lies outside");
        }
    }
    assert!(Hull::new((0..9).map(|i| Vec3::new((i % 3) as f32, (i / 3) as f32, 0.0))).is_none(), "a flat set has none");
}
