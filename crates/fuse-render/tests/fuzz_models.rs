//! Broken model files: the recorded ones of `corpus/` are taken or refused as `expected.txt` says;
//! damaged at random with a fixed seed, they never make a reader panic, hang or allocate much more
//! than the file is large. How many damages is fixed, so that each run tries the same ones.

#[path = "../../fuse-splat/tests/fuzz/damage.rs"]
mod damage;
#[path = "../../fuse-splat/tests/fuzz/memory.rs"]
mod memory;

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use damage::Damage;
use fuse_render::{ModelError, load};

/// Damages of one file that is taken whole, …
const DAMAGES: u32 = 240;
/// … and of one that is refused: most of its copies are refused for the same reason.
const DAMAGES_OF_BROKEN: u32 = 40;
/// Bytes that reading one damaged file, of a few kilobytes, may hold at a time.
const MEMORY: usize = 8 << 20;
/// How long it may take, on a busy machine.
const TIME: Duration = Duration::from_secs(2);

/// What a reader may do with a file, whatever is in it.
fn read(path: &Path) -> Result<(), ModelError> {
    let model = load(path)?;
    model.check().unwrap_or_else(|e| panic!("{}: an unsound model got in: {e}", path.display()));
    assert!(model.triangle_count() > 0);
    Ok(())
}

/// Reads a file of which nothing is known.
fn attempt(path: &Path, bytes: &[u8], number: u32) -> bool {
    std::fs::write(path, bytes).unwrap();
    let began = Instant::now();
    let outcome = std::panic::catch_unwind(|| memory::peak(|| read(path)));
    let Ok((result, peak)) = outcome else {
        panic!("{}: a reader panicked at damage {number}: {:?}", path.display(), String::from_utf8_lossy(bytes));
    };
    assert!(peak < MEMORY, "{}: {peak} bytes at damage {number} of {} bytes", path.display(), bytes.len());
    assert!(began.elapsed() < TIME, "{}: damage {number} took {:?}", path.display(), began.elapsed());
    if let Err(e) = &result {
        let message = e.to_string();
        assert!(message.len() < 4096 && message.contains(path.file_name().unwrap().to_str().unwrap()), "{message}");
    }
    result.is_ok()
}

/// A number, name or value of JSON for another.
fn edit(json: &[u8], seed: u32) -> Vec<u8> {
    const VALUES: [&str; 14] = [
        "0",
        "1",
        "3",
        "7",
        "255",
        "5120",
        "5126",
        "4294967295",
        "18446744073709551615",
        "-1",
        "1e30",
        "null",
        "\"x\"",
        "[]",
    ];
    let mut state = u64::from(seed).wrapping_mul(0x9E37_79B9_7F4A_7C15) | 1;
    let mut below = |n: usize| {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 33) as usize % n.max(1)
    };
    let starts: Vec<usize> = (1..json.len())
        .filter(|&i| b" [:,".contains(&json[i - 1]) && (json[i].is_ascii_digit() || json[i] == b'"' || json[i] == b'['))
        .collect();
    let Some(&at) = starts.get(below(starts.len())) else { return json.to_vec() };
    let length = match json[at] {
        b'"' => json[at + 1..].iter().position(|b| *b == b'"').map_or(1, |n| n + 2),
        b'[' => json[at..].iter().position(|b| *b == b']').map_or(1, |n| n + 1),
        _ => json[at..].iter().position(|b| !b.is_ascii_digit()).unwrap_or(1),
    };
    let mut out = json[..at].to_vec();
    out.extend(VALUES[below(VALUES.len())].bytes());
    out.extend(&json[at + length..]);
    out
}

/// The same for a GLB's JSON chunk, its lengths put right.
fn edit_glb(bytes: &[u8], seed: u32) -> Vec<u8> {
    let Some(length) = bytes.get(12..16).and_then(|b| b.try_into().ok()).map(u32::from_le_bytes) else {
        return bytes.to_vec();
    };
    let Some(json) = bytes.get(20..20 + length as usize) else { return bytes.to_vec() };
    let mut json = edit(json, seed);
    json.resize(json.len().next_multiple_of(4), b' ');
    let rest = &bytes[20 + length as usize..];
    let mut out = b"glTF\x02\0\0\0".to_vec();
    out.extend((20 + json.len() as u32 + rest.len() as u32).to_le_bytes());
    out.extend((json.len() as u32).to_le_bytes());
    out.extend(b"JSON");
    out.extend(&json);
    out.extend(rest);
    out
}

/// A reader's part of the corpus, all of it copied to a folder; files with what is expected of them.
fn corpus(reader: &str, folder: &Path) -> Vec<(PathBuf, String)> {
    let source = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/corpus");
    let list = std::fs::read_to_string(source.join("expected.txt")).unwrap();
    let expected: BTreeMap<&str, &str> = list.lines().map(|l| l.split_once('\t').unwrap()).collect();
    let mut names: Vec<_> = std::fs::read_dir(source.join(reader))
        .unwrap()
        .map(|e| e.unwrap().file_name().into_string().unwrap())
        .collect();
    names.sort();
    let mut files = vec![];
    for name in names {
        std::fs::copy(source.join(reader).join(&name), folder.join(&name)).unwrap();
        let found = expected.get(&format!("{reader}/{name}")[..]);
        files.extend(found.map(|words| (folder.join(&name), (*words).to_owned())));
    }
    let listed = expected.keys().filter(|k| k.starts_with(&format!("{reader}/"))).count();
    assert!(files.len() == listed && listed > 10, "{} files, {listed} listed", files.len());
    files
}

/// Reads each file whole, then damaged copies of it.
fn attack(reader: &str, edit: impl Fn(&[u8], u32) -> Vec<u8>) {
    let folder = tempfile::tempdir().unwrap();
    let (began, mut tried, mut taken) = (Instant::now(), 0, 0);
    for (path, expected) in corpus(reader, folder.path()) {
        let name = path.file_name().unwrap().to_string_lossy().into_owned();
        match (read(&path), expected.as_str()) {
            (Ok(()), "ok") => {}
            (Ok(()), _) => panic!("{name} was taken, expected: {expected}"),
            (Err(e), _) => {
                let message = e.to_string();
                assert!(message.contains(&expected) && message.contains(&name), "{message}, expected: {expected}");
            }
        }
        let original = std::fs::read(&path).unwrap();
        let mut damage = Damage::new(original.len() as u64);
        let damages = if expected == "ok" { DAMAGES } else { DAMAGES_OF_BROKEN };
        for number in 0..damages {
            let bytes = if number % 2 == 0 { damage.apply(&original) } else { edit(&original, number) };
            taken += u32::from(attempt(&path, &bytes, number));
        }
        tried += damages;
        std::fs::write(&path, &original).unwrap();
        assert_eq!(read(&path).is_ok(), expected == "ok", "{name}");
    }
    println!("{reader}: {tried} damaged files, {taken} of them taken, in {:.1?}", began.elapsed());
    // A reader that takes everything, or nothing, was not tested.
    assert!(0 < taken && taken < tried);
}

#[test]
fn glb() {
    attack("glb", edit_glb);
}

#[test]
fn gltf() {
    attack("gltf", edit);
}

#[test]
fn obj() {
    // Every other copy has two rounds of faults.
    attack("obj", |bytes, seed| {
        let mut damage = Damage::new(u64::from(seed) + 1);
        let once = damage.apply(bytes);
        damage.apply(&once)
    });
}
