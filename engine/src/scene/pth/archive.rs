//! The ZIP layer of a `.pth` file: stored entries only, found through the central directory.

use std::collections::HashMap;

use super::flaw::Flaw;

const END_MARK: &[u8] = b"PK\x05\x06";
const END_BYTES: usize = 22;
const MAX_COMMENT_BYTES: usize = 0xFFFF;
const CENTRAL_MARK: &[u8] = b"PK\x01\x02";
const CENTRAL_BYTES: usize = 46;
const LOCAL_MARK: &[u8] = b"PK\x03\x04";
const LOCAL_BYTES: usize = 30;
const FLAG_ENCRYPTED: usize = 1;
const METHOD_STORED: usize = 0;
/// Value of a 32-bit field whose real value is in a ZIP64 record.
const IN_ZIP64: usize = 0xFFFF_FFFF;

/// Suffix of the one entry that holds the pickle program.
const PICKLE_SUFFIX: &str = "/data.pkl";

/// A ZIP archive whose entries were located and checked against each other.
pub(super) struct Archive<'a> {
    entries: HashMap<&'a str, &'a [u8]>,
    root: &'a str,
}

impl<'a> Archive<'a> {
    /// Locates all entries and verifies their checksums.
    pub(super) fn open(file: &'a [u8]) -> Result<Self, Flaw> {
        let end = find_end(file)?;
        let record = &file[end..];
        let count = u16_at(record, 10)?;
        let size = u32_at(record, 12)?;
        let start = u32_at(record, 16)?;
        if start == IN_ZIP64 || size == IN_ZIP64 {
            return Err(flaw("a ZIP64 directory", "a file below 4 GiB"));
        }
        let directory = start
            .checked_add(size)
            .filter(|&directory_end| directory_end <= end)
            .and_then(|directory_end| file.get(start..directory_end))
            .ok_or_else(|| flaw("directory outside the file", "a complete archive"))?;
        let mut entries = HashMap::with_capacity(count);
        let mut at = 0;
        let mut bytes_left = start;
        for _ in 0..count {
            let entry = Entry::parse(&directory[at..])?;
            at += entry.directory_bytes;
            bytes_left = bytes_left
                .checked_sub(entry.size)
                .ok_or_else(|| flaw("entries larger than the file", "entries side by side"))?;
            let data = entry.data(&file[..start])?;
            if entries.insert(entry.name, data).is_some() {
                return Err(Flaw::new(entry.name, "present twice", "each entry once"));
            }
        }
        let root = find_root(&entries)?;
        let archive = Self { entries, root };
        archive.check_byte_order()?;
        Ok(archive)
    }

    /// The pickle program.
    pub(super) fn pickle(&self) -> Result<&'a [u8], Flaw> {
        self.entry("data.pkl")
    }

    /// Raw bytes of the storage `key`, which must be a decimal number.
    pub(super) fn storage(&self, key: &str) -> Result<&'a [u8], Flaw> {
        if key.is_empty() || !key.bytes().all(|byte| byte.is_ascii_digit()) {
            return Err(Flaw::new("storage key", format!("`{key}`"), "decimal digits"));
        }
        self.entry(&format!("data/{key}"))
    }

    fn entry(&self, name: &str) -> Result<&'a [u8], Flaw> {
        let name = format!("{}/{name}", self.root);
        let data = self.entries.get(name.as_str());
        data.copied().ok_or_else(|| Flaw::new(name, "missing", "an entry of the archive"))
    }

    fn check_byte_order(&self) -> Result<(), Flaw> {
        match self.entry("byteorder") {
            Ok(order) if order != b"little" => {
                let got = String::from_utf8_lossy(order).into_owned();
                Err(Flaw::new("byteorder", format!("`{got}`"), "`little`"))
            }
            _ => Ok(()),
        }
    }
}

fn find_root<'a>(entries: &HashMap<&'a str, &'a [u8]>) -> Result<&'a str, Flaw> {
    let mut roots = entries.keys().filter_map(|name| name.strip_suffix(PICKLE_SUFFIX));
    match (roots.next(), roots.next()) {
        (Some(root), None) => Ok(root),
        (None, _) => Err(flaw("no `data.pkl`", "a torch.save archive (torch 1.6 or newer)")),
        (Some(_), Some(_)) => Err(flaw("several `data.pkl`", "one")),
    }
}

/// One record of the central directory.
struct Entry<'a> {
    name: &'a str,
    crc: usize,
    size: usize,
    local_start: usize,
    /// Length of the record itself.
    directory_bytes: usize,
}

impl<'a> Entry<'a> {
    fn parse(record: &'a [u8]) -> Result<Self, Flaw> {
        if !record.starts_with(CENTRAL_MARK) {
            return Err(flaw("a damaged directory", "a complete archive"));
        }
        let name_end = CENTRAL_BYTES + u16_at(record, 28)?;
        let name = record.get(CENTRAL_BYTES..name_end).unwrap_or_default();
        let name = std::str::from_utf8(name).map_err(|_| flaw("an entry name that is no text", "UTF-8 names"))?;
        let directory_bytes = name_end + u16_at(record, 30)? + u16_at(record, 32)?;
        if directory_bytes > record.len() {
            return Err(flaw("a damaged directory", "a complete archive"));
        }
        let size = u32_at(record, 24)?;
        if u16_at(record, 8)? & FLAG_ENCRYPTED != 0 {
            return Err(Flaw::new(name, "encrypted", "a plain entry"));
        }
        if u16_at(record, 10)? != METHOD_STORED || u32_at(record, 20)? != size {
            return Err(Flaw::new(name, "compressed", "a stored entry, as torch writes"));
        }
        if size == IN_ZIP64 {
            return Err(Flaw::new(name, "a ZIP64 entry", "an entry below 4 GiB"));
        }
        Ok(Self { name, crc: u32_at(record, 16)?, size, local_start: u32_at(record, 42)?, directory_bytes })
    }

    /// The entry's bytes inside `body`, the file up to its directory, with their checksum verified.
    fn data(&self, body: &'a [u8]) -> Result<&'a [u8], Flaw> {
        let outside = || Flaw::new(self.name, "cut off", "an entry inside the file");
        let local = body.get(self.local_start..).ok_or_else(outside)?;
        if !local.starts_with(LOCAL_MARK) {
            return Err(Flaw::new(self.name, "no local header", "a complete archive"));
        }
        let name_end = LOCAL_BYTES + u16_at(local, 26)?;
        if local.get(LOCAL_BYTES..name_end) != Some(self.name.as_bytes()) {
            let expected = "the same name in directory and local header";
            return Err(Flaw::new(self.name, "another name", expected));
        }
        let start = name_end + u16_at(local, 28)?;
        let data = local.get(start..start + self.size).ok_or_else(outside)?;
        let crc = crc32(data);
        if crc as usize != self.crc {
            let got = format!("CRC-32 {crc:08x}");
            let expected = format!("{:08x}; the file is damaged", self.crc);
            return Err(Flaw::new(self.name, got, expected));
        }
        Ok(data)
    }
}

/// Offset of the end-of-directory record: the last one whose comment reaches the end of the file.
fn find_end(file: &[u8]) -> Result<usize, Flaw> {
    let last = file.len().checked_sub(END_BYTES);
    let last = last.ok_or_else(|| flaw(format!("{} bytes", file.len()), "a ZIP archive"))?;
    let first = last.saturating_sub(MAX_COMMENT_BYTES);
    let is_end = |&at: &usize| {
        let record = &file[at..];
        record.starts_with(END_MARK) && u16_at(record, 20).is_ok_and(|comment| at + END_BYTES + comment == file.len())
    };
    (first..=last).rev().find(is_end).ok_or_else(|| {
        let expected = "a complete ZIP archive from torch.save (torch 1.6 or newer)";
        flaw("no end-of-directory record", expected)
    })
}

fn flaw(got: impl Into<String>, expected: &str) -> Flaw {
    Flaw::new("archive", got, expected)
}

fn u16_at(bytes: &[u8], at: usize) -> Result<usize, Flaw> {
    let field = bytes.get(at..).and_then(<[u8]>::first_chunk);
    field
        .map(|&field| usize::from(u16::from_le_bytes(field)))
        .ok_or_else(|| flaw("a cut-off record", "a complete archive"))
}

fn u32_at(bytes: &[u8], at: usize) -> Result<usize, Flaw> {
    let field = bytes.get(at..).and_then(<[u8]>::first_chunk);
    field.map(|&field| u32::from_le_bytes(field) as usize).ok_or_else(|| flaw("a cut-off record", "a complete archive"))
}

/// CRC-32 of ZIP (reflected polynomial `EDB88320`), eight bits at a time.
fn crc32(data: &[u8]) -> u32 {
    const TABLE: [u32; 256] = crc_table();
    !data.iter().fold(!0, |crc: u32, &byte| TABLE[usize::from(crc.to_le_bytes()[0] ^ byte)] ^ (crc >> 8))
}

const fn crc_table() -> [u32; 256] {
    let mut table = [0_u32; 256];
    let mut index: u32 = 0;
    while index < 256 {
        let mut crc = index;
        let mut bit = 0;
        while bit < 8 {
            let mask = if crc & 1 == 1 { 0xEDB8_8320 } else { 0 };
            crc = (crc >> 1) ^ mask;
            bit += 1;
        }
        table[index as usize] = crc;
        index += 1;
    }
    table
}
