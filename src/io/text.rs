//! Text of input files: decompressed and decoded in one place, so that every reader accepts the same encodings.
//!
//! UTF-8 is the normal case. UTF-16 is recognised by its byte order mark or by the zero byte beside a first ASCII
//! character, gzip by its first two bytes. A gzip'd file may hold either encoding. Byte order marks are removed.
//!
//! Decompression stops at the reader's limit for the file, so that a small file cannot fill the memory.

use std::io::Read as _;
use std::path::Path;

use super::files::{self, InputError};

/// First bytes of a gzip file (RFC 1952).
const GZIP: [u8; 2] = [0x1f, 0x8b];

/// Why bytes are not text. The message names no file.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum TextError {
    /// A byte sequence that is not UTF-8.
    #[error("not text: byte {byte:#04x} is not UTF-8, expected UTF-8 or UTF-16")]
    NotUtf8 {
        /// Line of the byte, 1-based.
        line: u32,
        /// First invalid byte.
        byte: u8,
    },
    /// UTF-16 with half of a surrogate pair or half of a code unit.
    #[error("not text: invalid UTF-16")]
    NotUtf16 {
        /// Line of the first invalid code unit, 1-based.
        line: u32,
    },
    /// A gzip file that is damaged or cut off.
    #[error("damaged gzip data: {0}")]
    Gzip(#[source] std::io::Error),
    /// A gzip file with more content than the reader accepts.
    #[error("gzip data with more than {limit} bytes of content, the limit for such a file")]
    TooLarge {
        /// The limit, bytes.
        limit: u64,
    },
}

impl TextError {
    /// Line at which the text ends to be valid, 1-based; `None` if the error concerns the file as a whole.
    #[must_use]
    pub fn line(&self) -> Option<u32> {
        match self {
            Self::NotUtf8 { line, .. } | Self::NotUtf16 { line } => Some(*line),
            Self::Gzip(_) | Self::TooLarge { .. } => None,
        }
    }
}

/// Reads a file as text. `limit` is the largest size accepted, in bytes, of the file and of its decompressed content.
///
/// # Errors
/// The file cannot be read, is larger than `limit`, or is not text.
pub fn read(path: &Path, limit: u64) -> Result<String, InputError> {
    decode(path, files::read(path, limit)?, limit)
}

/// Decodes the bytes of a file; `name` stands for the file in messages.
///
/// # Errors
/// The bytes are not text, or have more than `limit` bytes of content after decompression.
pub fn decode(name: &Path, bytes: Vec<u8>, limit: u64) -> Result<String, InputError> {
    let text = decompressed(bytes, limit).and_then(decoded);
    text.map_err(|source| InputError::NotText { path: name.to_owned(), source })
}

fn decompressed(bytes: Vec<u8>, limit: u64) -> Result<Vec<u8>, TextError> {
    if !bytes.starts_with(&GZIP) {
        return Ok(bytes);
    }
    let mut content = Vec::new();
    let decoder = flate2::read::MultiGzDecoder::new(bytes.as_slice());
    decoder.take(limit.saturating_add(1)).read_to_end(&mut content).map_err(TextError::Gzip)?;
    if content.len() as u64 > limit { Err(TextError::TooLarge { limit }) } else { Ok(content) }
}

fn decoded(bytes: Vec<u8>) -> Result<String, TextError> {
    match bytes.as_slice() {
        [0xff, 0xfe, units @ ..] => utf16(units, u16::from_le_bytes),
        [0xfe, 0xff, units @ ..] => utf16(units, u16::from_be_bytes),
        [first, 0, ..] if *first != 0 => utf16(&bytes, u16::from_le_bytes),
        [0, first, ..] if *first != 0 => utf16(&bytes, u16::from_be_bytes),
        _ => utf8(bytes),
    }
}

fn utf8(bytes: Vec<u8>) -> Result<String, TextError> {
    /// The byte order mark in UTF-8.
    const MARK: &str = "\u{feff}";
    let mut text = String::from_utf8(bytes).map_err(|e| {
        let (valid, invalid) = e.as_bytes().split_at(e.utf8_error().valid_up_to());
        let line = line_after(valid.iter().filter(|b| **b == b'\n').count());
        TextError::NotUtf8 { line, byte: invalid.first().copied().unwrap_or_default() }
    })?;
    if text.starts_with(MARK) {
        text.drain(..MARK.len());
    }
    Ok(text)
}

fn utf16(bytes: &[u8], unit: fn([u8; 2]) -> u16) -> Result<String, TextError> {
    let (pairs, half) = bytes.as_chunks::<2>();
    let mut text = String::with_capacity(pairs.len());
    for character in char::decode_utf16(pairs.iter().map(|pair| unit(*pair))) {
        match character {
            Ok(character) => text.push(character),
            Err(_) => return Err(TextError::NotUtf16 { line: line_after(text.matches('\n').count()) }),
        }
    }
    if half.is_empty() { Ok(text) } else { Err(TextError::NotUtf16 { line: line_after(text.matches('\n').count()) }) }
}

fn line_after(line_breaks: usize) -> u32 {
    u32::try_from(line_breaks).unwrap_or(u32::MAX).saturating_add(1)
}

#[cfg(test)]
mod tests {
    use std::io::Write as _;

    use proptest::prelude::*;

    use super::*;

    const TEXT: &str = "<a>\n  é 𝄞 €\n</a>\n";
    const LIMIT: u64 = 1000;

    fn decode(bytes: &[u8]) -> Result<String, InputError> {
        super::decode(Path::new("a.xml"), bytes.to_vec(), LIMIT)
    }

    fn encoded(text: &str, bytes_of: fn(u16) -> [u8; 2]) -> Vec<u8> {
        text.encode_utf16().flat_map(bytes_of).collect()
    }

    fn gzip(bytes: &[u8]) -> Vec<u8> {
        let mut encoder = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::default());
        encoder.write_all(bytes).unwrap();
        encoder.finish().unwrap()
    }

    #[test]
    fn decodes_every_encoding_to_the_same_text() {
        let marked = format!("\u{feff}{TEXT}");
        let encodings = [
            TEXT.as_bytes().to_vec(),
            marked.as_bytes().to_vec(),
            encoded(TEXT, u16::to_le_bytes),
            encoded(TEXT, u16::to_be_bytes),
            encoded(&marked, u16::to_le_bytes),
            encoded(&marked, u16::to_be_bytes),
        ];
        for bytes in encodings {
            assert_eq!(decode(&bytes).unwrap(), TEXT, "{bytes:x?}");
            assert_eq!(decode(&gzip(&bytes)).unwrap(), TEXT, "gzip of {bytes:x?}");
        }
        let (start, end) = TEXT.split_at(5);
        let two_members = [gzip(start.as_bytes()), gzip(end.as_bytes())].concat();
        assert_eq!(decode(&two_members).unwrap(), TEXT);
        assert_eq!(decode(b"").unwrap(), "");
    }

    #[test]
    fn names_the_line_of_an_invalid_character() {
        let message = |bytes: &[u8]| decode(bytes).unwrap_err().to_string();
        assert_eq!(message(b"a\nb\xff"), "a.xml:2: not text: byte 0xff is not UTF-8, expected UTF-8 or UTF-16");
        let mut odd = encoded(TEXT, u16::to_le_bytes);
        odd.push(b'x');
        assert_eq!(message(&odd), "a.xml:4: not text: invalid UTF-16");
        let half_of_a_pair = [b'<', 0, b'\n', 0, 0x34, 0xd8, b'x', 0];
        assert_eq!(message(&half_of_a_pair), "a.xml:2: not text: invalid UTF-16");
    }

    #[test]
    fn refuses_damaged_and_oversized_gzip_data() {
        let whole = gzip(TEXT.as_bytes());
        for cut in [2, whole.len() / 2, whole.len() - 1] {
            let message = decode(&whole[..cut]).unwrap_err().to_string();
            assert!(message.starts_with("a.xml: damaged gzip data: "), "{message}");
        }
        let bomb = gzip(&vec![b' '; 10_000_000]);
        let message = super::decode(Path::new("a.xml"), bomb, 1 << 20).unwrap_err().to_string();
        assert!(message.contains("more than 1048576 bytes of content"), "{message}");
    }

    proptest! {
        #[test]
        fn never_panics(bytes in prop::collection::vec(any::<u8>(), 0..200), compress in any::<bool>()) {
            let bytes = if compress { gzip(&bytes) } else { bytes };
            let _ = decode(&bytes);
        }
    }
}
