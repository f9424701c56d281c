//! Looks at the lines of an OBJ file before it is read, so that what is wrong is named by line.

/// Corners of a face, at most: more is no face that people draw.
const MOST_CORNERS: usize = 4096;

/// How many positions, texture coordinates and normals there are.
type Counts = [usize; 3];

/// Checks every vertex and face; returns what is left out, in sentences.
pub fn check(bytes: &[u8]) -> Result<Vec<String>, String> {
    if bytes.is_empty() {
        return Err("it is empty".into());
    }
    let text = std::str::from_utf8(bytes)
        .map_err(|e| format!("it is not text: byte {} is not UTF-8, expected an OBJ file", e.valid_up_to()))?;
    let kinds = ["v", "vt", "vn"];
    let mut whole: Counts = [0; 3];
    for word in text.lines().filter_map(|l| l.split_whitespace().next()) {
        if let Some(k) = kinds.iter().position(|name| *name == word) {
            whole[k] += 1;
        }
    }
    let mut counts: Counts = [0; 3];
    let (mut faces, mut large, mut other, mut corners) = (0usize, 0usize, 0usize, 0usize);
    for (i, line) in text.lines().enumerate() {
        let mut words = line.split_whitespace();
        let at = |reason: String| format!("line {}: {reason}", i + 1);
        match words.next() {
            Some("v") => numbers(words, 3, "a vertex").map(|()| counts[0] += 1).map_err(at)?,
            Some("vt") => numbers(words, 1, "a texture coordinate").map(|()| counts[1] += 1).map_err(at)?,
            Some("vn") => numbers(words, 3, "a normal").map(|()| counts[2] += 1).map_err(at)?,
            Some("f") => {
                let n = face(words, counts, whole).map_err(at)?;
                faces += 1;
                large += usize::from(n > 4);
                corners += 3 * (n - 2);
                if corners > super::MOST_CORNERS || counts[0] > super::MOST_VERTICES {
                    return Err(at("the file has too many faces for a thing on a table".into()));
                }
            }
            Some("curv" | "curv2" | "surf" | "cstype") => other += 1,
            _ => {}
        }
    }
    if faces == 0 {
        return Err(format!("it has no triangles: {} vertices and no face", counts[0]));
    }
    let mut notes = vec![];
    if large > 0 {
        notes.push(format!(
            "{large} faces have more than four corners: each is cut into a fan, right where it is convex"
        ));
    }
    if other > 0 {
        notes.push("curves and free-form surfaces are left out".into());
    }
    Ok(notes)
}

fn numbers<'a>(words: impl Iterator<Item = &'a str>, least: usize, what: &str) -> Result<(), String> {
    let mut found = 0;
    for word in words.take(least) {
        match word.parse::<f32>() {
            Ok(v) if v.is_finite() => found += 1,
            Ok(_) => return Err(format!("{what} with the number {word:?}, which is not finite")),
            Err(_) => return Err(format!("{what} with {word:?}, expected a number")),
        }
    }
    if found < least { Err(format!("{what} of {found} numbers, expected {least}")) } else { Ok(()) }
}

/// Corners of a face; its indices count from 1, or back from -1 for the line above it.
fn face<'a>(words: impl Iterator<Item = &'a str>, above: Counts, whole: Counts) -> Result<usize, String> {
    const NAMES: [&str; 3] = ["vertex", "texture coordinate", "normal"];
    let mut corners = 0;
    for word in words.take_while(|w| !w.starts_with('#')) {
        corners += 1;
        for (k, index) in word.split('/').enumerate() {
            let (Some(&above), Some(&whole)) = (above.get(k), whole.get(k)) else {
                return Err(format!("a face's corner {word:?} has more than three indices"));
            };
            if index.is_empty() && k == 1 {
                continue;
            }
            let Ok(i) = index.parse::<i64>() else {
                return Err(format!("a face's corner {word:?}, expected an index such as 7, 7/3, 7//2 or 7/3/2"));
            };
            let have = if i < 0 { above } else { whole };
            if i == 0 || i.unsigned_abs() > have as u64 {
                let place = if i < 0 { "above it" } else { "in the file" };
                return Err(format!(
                    "a face uses {} {i}, but there are {have} {place}, counted from 1 (or back from -1)",
                    NAMES[k]
                ));
            }
        }
    }
    match corners {
        0..=2 => Err(format!("a face of {corners} corners, expected at least 3")),
        3..=MOST_CORNERS => Ok(corners),
        _ => Err(format!("a face of {corners} corners, expected at most {MOST_CORNERS}")),
    }
}
