//! Broken files: recorded ones, damaged at random with a fixed seed, never make a reader panic or
//! allocate much more than the file is large. Each reader runs for a bounded number of damages and
//! time.

#[path = "fuzz/damage.rs"]
mod damage;
#[path = "fuzz/memory.rs"]
mod memory;

use std::io::Read as _;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use flate2::Compression;
use flate2::read::{GzDecoder, GzEncoder};
use fuse_splat::data::Dataset;
use fuse_splat::{Gaussians, Trainer, TrainerConfig};

use damage::Damage;

/// Damages of one file, and the time after which no more are made.
const DAMAGES: u32 = 20_000;
const TIME: Duration = Duration::from_secs(1);
/// Bytes that reading one damaged file, of a few kilobytes, may hold at a time.
const MEMORY: usize = 8 << 20;

fn data(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data").join(name)
}

/// Damages `original` again and again, writes it to `path` and reads it with `read`, which says
/// whether the file was accepted.
fn attack(path: &Path, original: &[u8], wrap: impl Fn(Vec<u8>) -> Vec<u8>, read: impl Fn() -> bool) {
    let mut damage = Damage::new(original.len() as u64);
    let start = Instant::now();
    let (mut tried, mut accepted) = (0, 0);
    while tried < DAMAGES && start.elapsed() < TIME {
        let bytes = wrap(damage.apply(original));
        std::fs::write(path, &bytes).unwrap();
        let outcome = std::panic::catch_unwind(std::panic::AssertUnwindSafe(|| memory::peak(&read)));
        let Ok((taken, peak)) = outcome else {
            panic!("{}: a reader panicked at damage {tried}: {bytes:?}", path.display());
        };
        assert!(peak < MEMORY, "{}: {peak} bytes at damage {tried} of {} bytes", path.display(), bytes.len());
        tried += 1;
        accepted += u32::from(taken);
    }
    println!("{}: {tried} damaged files, {accepted} of them accepted", path.display());
    // A reader that accepts everything, or not even the whole file, was not tested.
    assert!(tried > accepted, "{}: {accepted} of {tried}", path.display());
    std::fs::write(path, wrap(original.to_vec())).unwrap();
    assert!(read(), "{} is refused", path.display());
}

fn finite(g: &Gaussians) -> bool {
    assert!((0..g.len()).all(|i| g.vector(i).iter().all(|v| v.is_finite())), "a value that is not finite got in");
    true
}

fn same(bytes: Vec<u8>) -> Vec<u8> {
    bytes
}

#[test]
fn ply() {
    let folder = tempfile::tempdir().unwrap();
    for name in ["big_endian.ply", "ascii.ply", "scene.ply"] {
        let path = folder.path().join(name);
        attack(&path, &std::fs::read(data(name)).unwrap(), same, || {
            Gaussians::from_ply(&path).is_ok_and(|g| finite(&g))
        });
    }
}

#[test]
fn spz() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("scene.spz");
    let read = || Gaussians::from_spz(&path).is_ok_and(|g| finite(&g));
    let zip = |bytes: Vec<u8>| {
        let mut out = Vec::new();
        GzEncoder::new(bytes.as_slice(), Compression::fast()).read_to_end(&mut out).unwrap();
        out
    };
    for name in ["niantic_v2.spz", "niantic_v3.spz"] {
        let packed = std::fs::read(data(name)).unwrap();
        // The compressed stream has a checksum and accepts hardly any damage: also within it.
        let mut inner = Vec::new();
        GzDecoder::new(packed.as_slice()).read_to_end(&mut inner).unwrap();
        attack(&path, &inner, zip, read);
        attack(&path, &packed, same, read);
    }
}

/// Copies a photo set and damages one of its files.
fn photo_set(name: &str, files: &[&str]) {
    let folder = tempfile::tempdir().unwrap();
    copy(&data(name), folder.path());
    for file in files {
        let path = folder.path().join(file);
        let original = std::fs::read(&path).unwrap();
        attack(&path, &original, same, || {
            let Ok(set) = Dataset::open(folder.path()) else { return false };
            let finite = set.xyz.iter().chain(&set.rgb).flatten().all(|v| v.is_finite());
            assert!(finite && !set.views.is_empty() && set.xyz.len() == set.rgb.len());
            for view in &set.views {
                assert!(view.path.starts_with(folder.path()), "{} is elsewhere", view.path.display());
                // Its errors are fine too.
                let _ = view.camera_at(1);
            }
            true
        });
        std::fs::write(&path, original).unwrap();
    }
}

fn copy(from: &Path, to: &Path) {
    std::fs::create_dir_all(to).unwrap();
    for entry in std::fs::read_dir(from).unwrap() {
        let path = entry.unwrap().path();
        let target = to.join(path.file_name().unwrap());
        if path.is_dir() { copy(&path, &target) } else { std::fs::copy(&path, &target).map(|_| ()).unwrap() }
    }
}

#[test]
fn colmap_binary() {
    photo_set("colmap_binary", &["sparse/0/cameras.bin", "sparse/0/images.bin", "sparse/0/points3D.bin"]);
}

#[test]
fn colmap_text() {
    photo_set("colmap_text", &["sparse/0/cameras.txt", "sparse/0/images.txt", "sparse/0/points3D.txt"]);
}

#[test]
fn nerfstudio() {
    photo_set("nerfstudio", &["transforms.json", "sparse_pc.ply"]);
}

#[test]
fn checkpoint() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("state");
    let new = || {
        let start = Gaussians::from_points(&[[0.0; 3], [0.1, 0.0, 0.0]], &[[0.5; 3]; 2]).unwrap();
        Trainer::new(start, TrainerConfig::default()).unwrap()
    };
    new().save_checkpoint(&path, "note").unwrap();
    let whole = std::fs::read(&path).unwrap();
    let body = &whole[..whole.len() - 4];
    // Damaged before its checksum is taken: what a checksum does not catch.
    let sum = |mut bytes: Vec<u8>| {
        let mut crc = flate2::Crc::new();
        crc.update(&bytes);
        bytes.extend(crc.sum().to_le_bytes());
        bytes
    };
    attack(&path, body, sum, || new().load_checkpoint(&path).is_ok());
}
