//! Little-endian numbers out of a file's bytes, each read checked against what is left.

/// What is left of a file.
pub(crate) struct Bytes<'a> {
    rest: &'a [u8],
    total: usize,
}

impl<'a> Bytes<'a> {
    pub fn new(bytes: &'a [u8]) -> Self {
        Self { rest: bytes, total: bytes.len() }
    }

    /// Bytes not yet read.
    pub fn left(&self) -> usize {
        self.rest.len()
    }

    /// The next `n` bytes, which are `what`.
    pub fn take(&mut self, n: usize, what: &str) -> Result<&'a [u8], String> {
        let (head, tail) = self
            .rest
            .split_at_checked(n)
            .ok_or_else(|| format!("truncated: the file ends after {} bytes, within {what}", self.total))?;
        self.rest = tail;
        Ok(head)
    }

    fn array<const N: usize>(&mut self, what: &str) -> Result<[u8; N], String> {
        let head = self.take(N, what)?;
        head.first_chunk().copied().ok_or_else(|| format!("truncated within {what}"))
    }

    pub fn u32(&mut self, what: &str) -> Result<u32, String> {
        self.array(what).map(u32::from_le_bytes)
    }

    pub fn u64(&mut self, what: &str) -> Result<u64, String> {
        self.array(what).map(u64::from_le_bytes)
    }

    pub fn f64(&mut self, what: &str) -> Result<f64, String> {
        self.array(what).map(f64::from_le_bytes)
    }

    /// `N` numbers.
    pub fn f64s<const N: usize>(&mut self, what: &str) -> Result<[f64; N], String> {
        let mut out = [0.0; N];
        for v in &mut out {
            *v = self.f64(what)?;
        }
        Ok(out)
    }

    /// A number of records of at least `size` bytes, refused where the rest of the file cannot hold
    /// so many: nothing is allocated for a count that a small file merely claims.
    pub fn count(&mut self, size: usize, what: &str) -> Result<usize, String> {
        let count = self.u64(what)?;
        let room = self.rest.len() / size;
        usize::try_from(count).ok().filter(|&n| n <= room).ok_or_else(|| {
            format!("{count} {what} announced, but the {} bytes that follow hold at most {room}", self.rest.len())
        })
    }

    /// Bytes up to a zero, which is skipped.
    pub fn text(&mut self, what: &str) -> Result<&'a str, String> {
        let end = self.rest.iter().position(|&b| b == 0).ok_or_else(|| format!("truncated within {what}"))?;
        let bytes = self.take(end + 1, what)?;
        std::str::from_utf8(&bytes[..end]).map_err(|_| format!("{what} is not UTF-8"))
    }
}
