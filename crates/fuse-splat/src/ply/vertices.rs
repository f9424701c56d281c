//! The vertices of any PLY: header, then scalar properties by name, from ASCII or binary of either
//! byte order.

/// A header longer than this is not one of ours.
const HEADER_MAX: usize = 64 * 1024;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Format {
    Ascii,
    Little,
    Big,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Kind {
    I8,
    U8,
    I16,
    U16,
    I32,
    U32,
    F32,
    F64,
}

impl Kind {
    fn parse(name: &str) -> Option<Self> {
        Some(match name {
            "char" | "int8" => Self::I8,
            "uchar" | "uint8" => Self::U8,
            "short" | "int16" => Self::I16,
            "ushort" | "uint16" => Self::U16,
            "int" | "int32" => Self::I32,
            "uint" | "uint32" => Self::U32,
            "float" | "float32" => Self::F32,
            "double" | "float64" => Self::F64,
            _ => return None,
        })
    }

    fn size(self) -> usize {
        match self {
            Self::I8 | Self::U8 => 1,
            Self::I16 | Self::U16 => 2,
            Self::I32 | Self::U32 | Self::F32 => 4,
            Self::F64 => 8,
        }
    }

    /// A number from its bytes, least significant first.
    fn value(self, b: [u8; 8]) -> f64 {
        let [b0, b1, b2, b3, ..] = b;
        match self {
            Self::I8 => f64::from(i8::from_le_bytes([b0])),
            Self::U8 => f64::from(b0),
            Self::I16 => f64::from(i16::from_le_bytes([b0, b1])),
            Self::U16 => f64::from(u16::from_le_bytes([b0, b1])),
            Self::I32 => f64::from(i32::from_le_bytes([b0, b1, b2, b3])),
            Self::U32 => f64::from(u32::from_le_bytes([b0, b1, b2, b3])),
            Self::F32 => f64::from(f32::from_le_bytes([b0, b1, b2, b3])),
            Self::F64 => f64::from_le_bytes(b),
        }
    }
}

struct Property {
    name: String,
    kind: Kind,
    /// In a vertex of a binary file.
    offset: usize,
}

/// The vertices of a file, not yet read.
pub(crate) struct Vertices<'a> {
    pub count: usize,
    format: Format,
    properties: Vec<Property>,
    /// Bytes of a vertex of a binary file.
    pub stride: usize,
    body: &'a [u8],
}

impl<'a> Vertices<'a> {
    /// Reads the header. The count is checked against what the file holds.
    pub fn parse(bytes: &'a [u8]) -> Result<Self, String> {
        if !bytes.starts_with(b"ply\n") && !bytes.starts_with(b"ply\r\n") {
            return Err("not a PLY file: it does not begin with `ply`".into());
        }
        let window = &bytes[..bytes.len().min(HEADER_MAX)];
        let (end, body) = header_end(window).ok_or("the header has no `end_header` line")?;
        let text = std::str::from_utf8(&window[..end]).map_err(|_| "the header is not text")?;
        let mut format = None;
        let mut count = None;
        let mut out = Self { count: 0, format: Format::Ascii, properties: Vec::new(), stride: 0, body: &bytes[body..] };
        for line in text.lines().skip(1) {
            let words: Vec<&str> = line.split_whitespace().collect();
            match words[..] {
                ["format", name, _] => format = Some(parse_format(name)?),
                ["element", "vertex", number] if count.is_none() => {
                    count = Some(number.parse().map_err(|_| format!("vertex count `{number}` is not a whole number"))?);
                }
                ["element", name, ..] => {
                    return Err(format!("element `{name}` found, expected one element `vertex` and no other"));
                }
                ["property", "list", ..] => return Err(format!("`{line}` found, expected scalar properties only")),
                ["property", kind, name] if count.is_some() => out.add(kind, name)?,
                ["comment" | "obj_info", ..] | [] => {}
                _ => return Err(format!("header line `{line}` not understood")),
            }
        }
        out.format = format.ok_or("the header has no `format` line")?;
        out.count = count.ok_or("the header has no `element vertex` line")?;
        out.check_size()?;
        Ok(out)
    }

    fn add(&mut self, kind: &str, name: &str) -> Result<(), String> {
        let kind = Kind::parse(kind).ok_or_else(|| format!("property {name} has unknown type {kind}"))?;
        if self.has(name) {
            return Err(format!("property `{name}` is there twice"));
        }
        self.properties.push(Property { name: name.into(), kind, offset: self.stride });
        self.stride += kind.size();
        Ok(())
    }

    /// Whether the file has a property of this name.
    pub fn has(&self, name: &str) -> bool {
        self.properties.iter().any(|p| p.name == name)
    }

    /// How many properties have this prefix and then a number.
    pub fn numbered(&self, prefix: &str) -> usize {
        let matches = |p: &&Property| p.name.strip_prefix(prefix).is_some_and(|n| n.parse::<u16>().is_ok());
        self.properties.iter().filter(matches).count()
    }

    /// Before anything is allocated for the count that the file claims.
    fn check_size(&self) -> Result<(), String> {
        let (count, available) = (self.count, self.body.len());
        if self.format == Format::Ascii {
            // A value takes at least a digit and a separator.
            let least = count.checked_mul(2 * self.properties.len().max(1));
            return match least.filter(|&n| n <= available + 1) {
                Some(_) => Ok(()),
                None => Err(format!(
                    "{count} vertices of {} properties announced, found {available} bytes of text after the header",
                    self.properties.len()
                )),
            };
        }
        match count.checked_mul(self.stride).filter(|&n| n == available) {
            Some(_) => Ok(()),
            None => Err(format!(
                "{count} vertices of {} bytes announced, found {available} bytes after the header",
                self.stride
            )),
        }
    }

    /// The named properties of each vertex, one row a vertex, each checked to be finite; `unbounded`
    /// names one that may be infinite.
    ///
    /// `expected` says in words what a file with these properties is.
    pub fn read(&self, names: &[String], unbounded: &str, expected: &str) -> Result<Vec<Vec<f32>>, String> {
        let mut wanted = Vec::with_capacity(names.len());
        for name in names {
            let index = self.properties.iter().position(|p| &p.name == name);
            wanted.push(index.ok_or_else(|| format!("property `{name}` is missing; expected {expected}"))?);
        }
        let rows = match self.format {
            Format::Ascii => self.read_text(&wanted)?,
            Format::Little | Format::Big => self.read_binary(&wanted),
        };
        for (i, row) in rows.iter().enumerate() {
            let bad = |(name, v): (&String, &f32)| v.is_nan() || (v.is_infinite() && name != unbounded);
            if let Some(bad) = names.iter().zip(row).position(bad) {
                return Err(format!("`{}` of vertex {i} is {}, expected a finite number", names[bad], row[bad]));
            }
        }
        Ok(rows)
    }

    fn read_binary(&self, wanted: &[usize]) -> Vec<Vec<f32>> {
        if self.stride == 0 {
            return Vec::new();
        }
        let value = |vertex: &[u8], index: &usize| {
            let Property { kind, offset, .. } = self.properties[*index];
            let mut raw = [0; 8];
            let bytes = &vertex[offset..offset + kind.size()];
            raw[..bytes.len()].copy_from_slice(bytes);
            if self.format == Format::Big {
                raw[..bytes.len()].reverse();
            }
            kind.value(raw) as f32
        };
        self.body.chunks_exact(self.stride).map(|v| wanted.iter().map(|i| value(v, i)).collect()).collect()
    }

    fn read_text(&self, wanted: &[usize]) -> Result<Vec<Vec<f32>>, String> {
        let text = std::str::from_utf8(self.body).map_err(|_| "the vertices are not text, as `format ascii` says")?;
        let mut words = text.split_ascii_whitespace();
        let mut rows = Vec::with_capacity(self.count);
        let mut vertex = vec![""; self.properties.len()];
        for i in 0..self.count {
            for slot in &mut vertex {
                *slot = words.next().ok_or_else(|| format!("the text ends within vertex {i} of {}", self.count))?;
            }
            let parse = |&k: &usize| {
                vertex[k].parse::<f32>().map_err(|_| {
                    format!("`{}` of vertex {i} is `{}`, expected a number", self.properties[k].name, vertex[k])
                })
            };
            rows.push(wanted.iter().map(parse).collect::<Result<_, _>>()?);
        }
        match words.next() {
            None => Ok(rows),
            Some(word) => Err(format!("`{word}` follows the last of {} vertices", self.count)),
        }
    }
}

fn parse_format(name: &str) -> Result<Format, String> {
    match name {
        "ascii" => Ok(Format::Ascii),
        "binary_little_endian" => Ok(Format::Little),
        "binary_big_endian" => Ok(Format::Big),
        other => Err(format!("format `{other}` unknown, expected ascii, binary_little_endian or binary_big_endian")),
    }
}

/// Where the `end_header` line starts, and where the vertices do.
fn header_end(window: &[u8]) -> Option<(usize, usize)> {
    const END: &[u8] = b"\nend_header";
    let at = window.windows(END.len()).position(|w| w == END)? + 1;
    let after = at + END.len() - 1;
    match (window.get(after), window.get(after + 1)) {
        (Some(b'\n'), _) => Some((at, after + 1)),
        (Some(b'\r'), Some(b'\n')) => Some((at, after + 2)),
        _ => None,
    }
}
