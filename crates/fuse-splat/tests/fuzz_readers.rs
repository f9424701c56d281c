//! Broken files: the recorded ones of `corpus/` are taken or refused as `expected.txt` says; damaged
//! at random with a fixed seed, they never make a reader panic or allocate much more than the file is
//! large. How many damages is fixed, so that each run tries the same ones.

#[path = "fuzz/damage.rs"]
mod damage;
#[path = "fuzz/memory.rs"]
mod memory;
#[path = "fuzz/readers.rs"]
mod readers;

use std::collections::BTreeMap;
use std::io::Read as _;
use std::path::{Path, PathBuf};

use flate2::Compression;
use flate2::read::{GzDecoder, GzEncoder};
use fuse_splat::{Gaussians, SplatError, Trainer, TrainerConfig};

use damage::Damage;
use readers::{copy, place};

/// Damages of one file that is taken whole, …
const DAMAGES: u32 = 700;
/// … and of one that is refused: most of its copies are refused for the same reason.
const DAMAGES_OF_BROKEN: u32 = 100;
/// Bytes that reading one damaged file, of a few kilobytes, may hold at a time.
const MEMORY: usize = 8 << 20;

/// Files that other programs wrote.
fn data(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data").join(name)
}

type Read<'a> = &'a dyn Fn(&Path) -> Result<(), SplatError>;

/// Damages `original` again and again, writes it to `path` and reads it; says how many damaged files
/// were taken, and whether the whole one is.
fn attack(
    path: &Path,
    original: &[u8],
    damages: u32,
    wrap: impl Fn(Vec<u8>) -> Vec<u8>,
    read: Read<'_>,
) -> (u32, bool) {
    let mut damage = Damage::new(original.len() as u64);
    let mut taken = 0;
    for number in 0..damages {
        let bytes = wrap(damage.apply(original));
        std::fs::write(path, &bytes).unwrap();
        let outcome = std::panic::catch_unwind(std::panic::AssertUnwindSafe(|| memory::peak(|| read(path))));
        let Ok((result, peak)) = outcome else {
            panic!("{}: a reader panicked at damage {number}: {bytes:?}", path.display());
        };
        assert!(peak < MEMORY, "{}: {peak} bytes at damage {number} of {} bytes", path.display(), bytes.len());
        if let Err(e) = &result {
            assert_one_sentence(&e.to_string());
        }
        taken += u32::from(result.is_ok());
    }
    println!("{}: {damages} damaged files, {taken} of them taken", path.display());
    // A reader that takes everything was not tested.
    assert!(taken < damages, "{}: all were taken", path.display());
    std::fs::write(path, wrap(original.to_vec())).unwrap();
    (taken, read(path).is_ok())
}

fn assert_one_sentence(message: &str) {
    assert!(!message.is_empty() && message.len() < 4096, "{} bytes of message", message.len());
}

fn same(bytes: Vec<u8>) -> Vec<u8> {
    bytes
}

/// File and expectation of a reader's part of the corpus.
fn corpus(reader: &str) -> Vec<(String, PathBuf, String)> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/corpus");
    let list = std::fs::read_to_string(folder.join("expected.txt")).unwrap();
    let expected: BTreeMap<&str, &str> = list.lines().map(|l| l.split_once('\t').unwrap()).collect();
    let mut files: Vec<_> = std::fs::read_dir(folder.join(reader)).unwrap().map(|e| e.unwrap().path()).collect();
    files.sort();
    assert!(files.len() > 5, "{reader} has {} files", files.len());
    files
        .into_iter()
        .map(|path| {
            let name = path.file_name().unwrap().to_str().unwrap().to_string();
            let key = format!("{reader}/{name}");
            let words = expected.get(&key[..]).unwrap_or_else(|| panic!("{key} is not in expected.txt"));
            (name, path, (*words).to_string())
        })
        .collect()
}

fn damages(expected: &str) -> u32 {
    if expected == "ok" { DAMAGES } else { DAMAGES_OF_BROKEN }
}

/// Reads a whole file of the corpus, then damaged copies of it.
fn check(name: &str, source: &Path, expected: &str, target: &Path, read: Read<'_>) {
    let original = std::fs::read(source).unwrap();
    std::fs::write(target, &original).unwrap();
    match (read(target), expected) {
        (Ok(()), "ok") => {}
        (Ok(()), _) => panic!("{name} was taken, expected: {expected}"),
        (Err(e), _) => {
            let message = e.to_string();
            assert!(message.contains(expected), "{name}: {message}, expected: {expected}");
        }
    }
    let (_, whole) = attack(target, &original, damages(expected), same, read);
    assert_eq!(whole, expected == "ok", "{name}");
}

#[test]
fn ply() {
    let folder = tempfile::tempdir().unwrap();
    for (name, source, expected) in corpus("ply") {
        check(&name, &source, &expected, &folder.path().join(&name), &readers::ply);
    }
}

#[test]
fn spz() {
    let folder = tempfile::tempdir().unwrap();
    let zip = |bytes: Vec<u8>| {
        let mut out = Vec::new();
        GzEncoder::new(bytes.as_slice(), Compression::fast()).read_to_end(&mut out).unwrap();
        out
    };
    for (name, source, expected) in corpus("spz") {
        let target = folder.path().join(&name);
        check(&name, &source, &expected, &target, &readers::spz);
        // The compressed stream has a checksum and lets hardly any damage through: also within it.
        let mut inner = Vec::new();
        if GzDecoder::new(&std::fs::read(&source).unwrap()[..]).read_to_end(&mut inner).is_ok() {
            attack(&target, &inner, damages(&expected), zip, &readers::spz);
        }
    }
}

/// A photo set in which one file is another.
fn photo_set(reader: &str) {
    let folder = tempfile::tempdir().unwrap();
    let read = |_: &Path| readers::photo_set(folder.path());
    copy(&data(reader), folder.path());
    for (name, source, expected) in corpus(reader) {
        let target = place(reader, folder.path(), &name);
        let good = std::fs::read(&target).unwrap();
        check(&name, &source, &expected, &target, &read);
        std::fs::write(&target, good).unwrap();
    }
}

#[test]
fn colmap_binary() {
    photo_set("colmap_binary");
}

#[test]
fn colmap_text() {
    photo_set("colmap_text");
}

#[test]
fn nerfstudio() {
    photo_set("nerfstudio");
    let folder = tempfile::tempdir().unwrap();
    copy(&data("nerfstudio"), folder.path());
    let cloud = folder.path().join("sparse_pc.ply");
    let original = std::fs::read(&cloud).unwrap();
    let (taken, whole) = attack(&cloud, &original, DAMAGES, same, &|_| readers::photo_set(folder.path()));
    assert!(taken > 0 && whole);
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
    assert!(attack(&path, body, DAMAGES, sum, &|path| new().load_checkpoint(path).map(|_| ())).1);
}
