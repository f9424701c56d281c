//! Files of a tetrahedron become objects, or are refused for a reason.

use std::path::Path;

use glam::Vec3;

use super::*;
use crate::catalogue::Catalogue;
use crate::library;

fn options(category: &str) -> ImportOptions {
    ImportOptions {
        category: Category::named(category).expect("a sound name"),
        split: Split::Eval,
        metres_per_unit: 1.0,
        up: None,
        id: None,
    }
}

/// A box with corners at `low` and `high`, without a lid if it is open.
fn write_box(path: &Path, low: Vec3, high: Vec3, open: bool) {
    let mut text = String::new();
    for i in 0..8 {
        let pick = |k: usize| if i >> k & 1 == 1 { high[k] } else { low[k] };
        text += &format!("v {} {} {}\n", pick(0), pick(1), pick(2));
    }
    text += "f 1 3 4 2\nf 1 2 6 5\nf 2 4 8 6\nf 4 3 7 8\nf 3 1 5 7\n";
    if !open {
        text += "f 5 6 8 7\n";
    }
    std::fs::write(path, text).expect("a temporary folder can be written");
}

fn folder() -> tempfile::TempDir {
    tempfile::tempdir().expect("there is room for a temporary folder")
}

#[test]
fn a_closed_box_is_centred_measured_and_rests_on_its_sides() {
    let folder = folder();
    let path = folder.path().join("My Box (2).obj");
    write_box(&path, Vec3::new(5.0, 5.0, 5.0), Vec3::new(15.0, 13.0, 9.0), false);
    let made = import(&path, &ImportOptions { metres_per_unit: 0.01, ..options("crate") }).expect("a sound box");
    let (low, high) = made.model.bounds().expect("it has vertices");
    assert!(
        (low - Vec3::new(-0.05, -0.04, 0.0)).length() < 1e-6 && (high - Vec3::new(0.05, 0.04, 0.04)).length() < 1e-6
    );
    assert_eq!(made.record.id, "my_box__2");
    let found = made.record.imported.expect("it is imported");
    assert!(found.closed && found.mass_from == MassFrom::Solid && found.warnings.is_empty(), "{found:?}");
    assert!((found.volume_m3 - 3.2e-4).abs() < 1e-8 && (found.mass_kg - 0.32).abs() < 1e-5, "{found:?}");
    assert_eq!(made.record.resting.len(), 6);
    let total: f32 = made.record.resting.iter().map(|p| p.probability).sum();
    assert!((total - 1.0).abs() < 1e-5);
    // It lies on its largest sides most often, 2 cm under its middle.
    assert!((made.record.resting[0].rotation() * Vec3::Z).z.abs() > 0.999);
}

#[test]
fn an_open_box_rests_by_its_hull_and_says_so() {
    let folder = folder();
    let path = folder.path().join("tray.obj");
    write_box(&path, Vec3::ZERO, Vec3::new(0.3, 0.2, 0.05), true);
    let made = import(&path, &options("tray")).expect("an open box is taken");
    let found = made.record.imported.expect("it is imported");
    assert!(!found.closed && found.mass_from == MassFrom::Hull);
    assert!((found.volume_m3 - 0.003).abs() < 1e-5, "{found:?}");
    assert!(found.warnings.iter().any(|w| w.contains("open (4 edges)") && w.contains("convex hull")), "{found:?}");
    // As made, as trays are; else mostly upside down.
    let [own, other, ..] = made.record.resting[..] else { panic!("{:?}", made.record.resting) };
    assert!(own.probability > 0.97 && own.rotation().angle_between(glam::Quat::IDENTITY) < 1e-3);
    assert!((other.rotation() * Vec3::Z).z < -0.999);
}

#[test]
fn the_axis_that_points_up_can_be_said() {
    let folder = folder();
    let path = folder.path().join("post.obj");
    write_box(&path, Vec3::ZERO, Vec3::new(0.02, 0.3, 0.04), false);
    let sizes = [None, Some(Up::Z), Some(Up::Y)]
        .map(|up| import(&path, &ImportOptions { up, ..options("post") }).expect("a sound box").record.size_m);
    assert!((sizes[0][2] - 0.04).abs() < 1e-6 && sizes[0] == sizes[1]);
    assert!((sizes[2][2] - 0.3).abs() < 1e-6 && (sizes[2][1] - 0.04).abs() < 1e-6);
}

#[test]
fn impossible_sizes_name_the_likely_unit() {
    let folder = folder();
    let path = folder.path().join("mug.obj");
    let say = |side: f32, scale: f64, category: &str| {
        write_box(&path, Vec3::ZERO, Vec3::splat(side), false);
        let made = import(&path, &ImportOptions { metres_per_unit: scale, ..options(category) });
        made.map_or_else(|e| e.to_string(), |m| m.record.imported.map_or_else(Vec::new, |i| i.warnings).join("; "))
    };
    let message = say(50.0, 1.0, "mug");
    assert!(message.contains("mug.obj: its longest side is 50 m, expected 5 mm to 2 m"), "{message}");
    assert!(say(100.0, 1.0, "mug").ends_with("did you mean --unit mm (10 cm)?"));
    assert!(say(10.0, 1.0, "mug").ends_with("did you mean --unit cm (10 cm)?"));
    let message = say(0.1, 0.001, "mug");
    assert!(message.contains("its longest side is 0.1 mm") && message.ends_with("--unit m (10 cm)?"), "{message}");
    assert!(say(1e-6, 1.0, "crate").contains("no common unit fits, --scale 1.500e5 would make it 15 cm"));
    assert!(say(0.9, 1.0, "mug").contains("usually 6 cm to 20 cm: check the unit"));
    assert!(say(0.1, f64::NAN, "mug").contains("a scale must be finite"));
    assert!(say(0.1, 1.0, "mug").is_empty());
}

#[test]
fn names_are_kept_apart_from_those_of_the_shipped_set() {
    let folder = folder();
    let path = folder.path().join("mug_eval_7.obj");
    write_box(&path, Vec3::ZERO, Vec3::splat(0.1), false);
    let refuse = |id: Option<&str>| {
        let asked = ImportOptions { id: id.map(str::to_owned), ..options("mug") };
        import(&path, &asked).map_or_else(|e| e.to_string(), |m| m.record.id)
    };
    assert!(refuse(None).contains("the shipped set has objects named so"));
    assert!(refuse(Some("../mug")).contains("expected lower-case letters"));
    assert_eq!(refuse(Some("my-mug_7")), "my-mug_7");
}

#[test]
fn a_library_keeps_what_it_is_told_and_nothing_else() {
    let folder = folder();
    let path = folder.path().join("oar.obj");
    write_box(&path, Vec3::ZERO, Vec3::new(0.3, 0.05, 0.02), false);
    let made = import(&path, &options("paddle")).expect("a sound box");
    let home = folder.path().join("library");
    let verbs = ["stir".to_owned()];
    library::add(&home, &made, b"png", &verbs, false).expect("a new library");
    let again = library::add(&home, &made, b"png", &[], false).expect_err("it is there").to_string();
    assert!(again.contains("object `oar` is in") && again.contains("--replace"), "{again}");
    library::add(&home, &made, b"png", &["scoop".into()], true).expect("replaced");
    let library = Catalogue::load(&home).expect("a sound library");
    assert_eq!(library.records(), std::slice::from_ref(&made.record));
    let stated: Vec<_> = library.categories()[0].valid_for.iter().collect();
    assert_eq!(stated.len(), 2);
    assert!(stated.iter().all(|(_, why)| *why == library::STATED));
    assert_eq!(library.model(&made.record).expect("its model").triangle_count(), 12);
    assert_eq!(library.category("paddle").expect("its own").id(), "paddle");
    assert!(library.category("padle").is_err() && library.category("mug").is_ok());
    let mut names: Vec<_> =
        std::fs::read_dir(&home).expect("a folder").map(|e| e.expect("an entry").file_name()).collect();
    names.sort();
    assert_eq!(names, ["catalogue.json", "oar.glb", "oar.png"]);
    // What is no library is left alone.
    let full = folder.path().join("full");
    std::fs::create_dir(&full).expect("a folder");
    std::fs::write(full.join("mine.txt"), "keep").expect("a file");
    assert!(library::add(&full, &made, b"png", &[], false).is_err());
    assert_eq!(std::fs::read_dir(&full).expect("a folder").count(), 1);
    let twice = Catalogue::load_all(&[&home, &home]).expect_err("the same ids").to_string();
    assert!(twice.contains("object `oar` is in") && twice.contains("expected different ids"), "{twice}");
}

#[test]
fn categories_are_shipped_ones_or_well_named() {
    assert_eq!(Category::named("mug").expect("shipped"), Category::Mug);
    let own = Category::named("garlic_press").expect("a new one");
    assert!(own.is_own() && own == Category::named("garlic_press").expect("the same") && own > Category::Can);
    let text = serde_json::to_string(&own).expect("a string");
    assert_eq!(serde_json::from_str::<Category>(&text).expect("read back"), own);
    for bad in ["", "Mug", "2mug", "a b", "müsli", "../x", &"x".repeat(49)] {
        assert!(Category::named(bad).is_err(), "{bad:?}");
    }
    assert!("garlic_press".parse::<Category>().is_err(), "it has no generator");
}
