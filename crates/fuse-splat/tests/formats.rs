//! Files that other programs wrote (tests/data/README.md), and theirs that ours must equal.

use std::io::Read as _;
use std::path::{Path, PathBuf};

use flate2::read::GzDecoder;
use fuse_splat::Gaussians;
use fuse_splat::data::Dataset;

fn data(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data").join(name)
}

fn unzipped(path: &Path) -> Vec<u8> {
    let mut out = Vec::new();
    GzDecoder::new(std::fs::File::open(path).unwrap()).read_to_end(&mut out).unwrap();
    out
}

#[test]
fn plys_in_all_three_formats_hold_the_same() {
    let scene = Gaussians::from_ply(&data("scene.ply")).unwrap();
    assert_eq!(scene.len(), 40);
    for name in ["ascii.ply", "big_endian.ply"] {
        let other = Gaussians::from_ply(&data(name)).unwrap();
        assert_eq!(other.len(), 3);
        for i in 0..3 {
            assert_eq!(other.vector(i), scene.vector(i), "{name}");
        }
    }
}

#[test]
fn spz_agrees_with_niantics_library() {
    let truth = Gaussians::from_ply(&data("scene.ply")).unwrap();
    // (rows, largest error, of version 2 where it differs)
    let steps = [(0..3, 1.3e-4), (3..6, 0.032), (11..14, 0.0132), (14..59, 0.0665)];
    for (name, least_cosine) in [("niantic_v2.spz", 0.999), ("niantic_v3.spz", 0.999_99)] {
        let read = Gaussians::from_spz(&data(name)).unwrap();
        assert_eq!(read.len(), truth.len());
        for i in 0..truth.len() {
            let (a, b) = (read.vector(i), truth.vector(i));
            for (rows, step) in &steps {
                for r in rows.clone() {
                    assert!((a[r] - b[r]).abs() <= *step, "{name}, Gaussian {i}, row {r}: {} for {}", a[r], b[r]);
                }
            }
            assert!((read.opacity(i) - truth.opacity(i)).abs() <= 0.5 / 255.0 + 1e-6);
            let dot: f32 = (6..10).map(|k| a[k] * b[k]).sum();
            let length = |v: &[f32; 59]| v[6..10].iter().map(|x| x * x).sum::<f32>().sqrt();
            assert!(dot.abs() / (length(&a) * length(&b)) > least_cosine, "{name}, Gaussian {i}");
        }
    }
}

#[test]
fn spz_is_written_byte_for_byte_as_niantics_library_does() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("ours.spz");
    Gaussians::from_ply(&data("scene.ply")).unwrap().save_spz(&path).unwrap();
    // Compressors differ, what they compress does not.
    assert!(unzipped(&path) == unzipped(&data("niantic_v3.spz")));
}

#[test]
fn three_forms_of_one_photo_set_agree() {
    let sets: Vec<Dataset> =
        ["colmap_binary", "colmap_text", "nerfstudio"].map(|n| Dataset::open(&data(n)).unwrap()).into();
    assert_eq!(sets.iter().map(|s| s.kind).collect::<Vec<_>>(), ["colmap", "colmap", "nerfstudio"]);
    let first = &sets[0];
    assert_eq!(
        first.views.iter().map(|v| &v.name[..]).collect::<Vec<_>>(),
        ["view 000.png", "view 001.png", "view 002.png"]
    );
    for set in &sets {
        assert!(set.notes.is_empty());
        assert_eq!((set.views.len(), set.xyz.len(), set.rgb.len()), (3, 12, 12));
        for (a, b) in set.views.iter().zip(&first.views) {
            assert!(a.camera.pose.rotation.angle_to(&b.camera.pose.rotation) < 1e-7);
            assert!((a.camera.pose.translation - b.camera.pose.translation).norm() < 1e-9);
            let (k, l) = (&a.camera.intrinsics, &b.camera.intrinsics);
            assert!((k.width, k.height) == (32, 24) && (k.fx - l.fx).abs() < 1e-9 && (k.cy - l.cy).abs() < 1e-9);
            assert_eq!(a.read(1).unwrap().image, b.read(1).unwrap().image);
        }
        // COLMAP's points have no order.
        let sorted = |s: &Dataset| {
            let mut all: Vec<_> = s
                .xyz
                .iter()
                .zip(&s.rgb)
                .map(|(p, c)| (p.map(|v| (v * 1e5).round() as i64), c.map(|v| (v * 255.0).round() as u8)))
                .collect();
            all.sort_unstable();
            all
        };
        assert_eq!(sorted(set), sorted(first));
    }
}
