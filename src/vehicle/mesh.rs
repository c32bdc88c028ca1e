//! Reads the vertices of mesh files: Wavefront OBJ and STL, text and binary.
//!
//! Only positions are read, since the footprint is their convex hull on the ground: the `v` lines of an OBJ, the corners
//! of the facets of an STL. Faces, normals, materials and units are ignored. Some binary STL files begin with `solid` like
//! text; a file is binary if its length matches its number of facets.

/// Largest mesh file, bytes. A footprint needs some hundred vertices.
pub(super) const MAX_BYTES: u64 = 64 << 20;

/// Why the vertices of a mesh cannot be read.
#[derive(Debug, thiserror::Error)]
pub enum MeshError {
    /// An URL like `package://…`, which needs a ROS installation.
    #[error("a URL; expected the name of a file beside the URDF")]
    Address,
    /// An unknown file extension.
    #[error("unknown kind of mesh; expected .obj or .stl")]
    Kind,
    /// The file is missing or cannot be read.
    #[error("cannot be read: {0}")]
    Unreadable(#[from] std::io::Error),
    /// The file is larger than a mesh for collision checks needs.
    #[error("larger than {} MiB; expected a simple mesh for collision checks", MAX_BYTES >> 20)]
    TooLarge,
    /// A vertex line without three numbers.
    #[error("line {line}: `{found}`; expected three numbers")]
    Line {
        /// Line, 1-based.
        line: usize,
        /// Its first 60 characters.
        found: String,
    },
    /// Neither a text STL nor a binary one whose length matches its number of facets.
    #[error("neither a text STL nor a complete binary one")]
    Truncated,
    /// A coordinate that is not finite.
    #[error("vertex {vertex} is not finite")]
    NotFinite {
        /// Number of the vertex, from 1.
        vertex: usize,
    },
    /// No vertices.
    #[error("no vertices")]
    Empty,
}

/// Whether the file is an STL; otherwise it is an OBJ.
///
/// # Errors
/// A URL, or another extension.
pub(super) fn is_stl(name: &str) -> Result<bool, MeshError> {
    if name.contains("://") {
        return Err(MeshError::Address);
    }
    let is =
        |extension: &str| std::path::Path::new(name).extension().is_some_and(|e| e.eq_ignore_ascii_case(extension));
    if is("stl") {
        Ok(true)
    } else if is("obj") {
        Ok(false)
    } else {
        Err(MeshError::Kind)
    }
}

/// The vertices of a file, at least one, all finite.
pub(super) fn vertices(is_stl: bool, bytes: &[u8]) -> Result<Vec<[f64; 3]>, MeshError> {
    let vertices = if !is_stl {
        from_lines(bytes, "v")?
    } else if let Some(facets) = binary_facets(bytes) {
        facets.iter().flat_map(facet_corners).collect()
    } else if bytes.trim_ascii_start().starts_with(b"solid") {
        from_lines(bytes, "vertex")?
    } else {
        return Err(MeshError::Truncated);
    };
    if let Some(i) = vertices.iter().position(|v| !v.iter().all(|c| c.is_finite())) {
        return Err(MeshError::NotFinite { vertex: i + 1 });
    }
    if vertices.is_empty() { Err(MeshError::Empty) } else { Ok(vertices) }
}

/// The first three numbers of each line that begins with the keyword.
fn from_lines(bytes: &[u8], keyword: &str) -> Result<Vec<[f64; 3]>, MeshError> {
    let vertex = |(i, line): (usize, &[u8])| {
        let line = line.trim_ascii().strip_prefix(keyword.as_bytes())?;
        if !line.first().is_none_or(u8::is_ascii_whitespace) {
            return None; // another keyword, such as `vn`
        }
        let text = String::from_utf8_lossy(line);
        let mut numbers = text.split_ascii_whitespace().map_while(|word| word.parse::<f64>().ok());
        match (numbers.next(), numbers.next(), numbers.next()) {
            (Some(x), Some(y), Some(z)) => Some(Ok([x, y, z])),
            _ => {
                Some(Err(MeshError::Line { line: i + 1, found: format!("{keyword}{text}").chars().take(60).collect() }))
            }
        }
    };
    bytes.split(|b| *b == b'\n').enumerate().filter_map(vertex).collect()
}

/// Bytes of a facet in a binary STL: normal, three corners, attribute (two bytes).
const FACET: usize = 50;

/// The facets of a binary STL; `None` if the length does not match their number.
fn binary_facets(bytes: &[u8]) -> Option<&[[u8; FACET]]> {
    let (count, facets) = bytes.get(80..)?.split_first_chunk::<4>()?;
    let (facets, remainder) = facets.as_chunks::<FACET>();
    (remainder.is_empty() && u32::try_from(facets.len()).ok()? == u32::from_le_bytes(*count)).then_some(facets)
}

fn facet_corners(facet: &[u8; FACET]) -> Vec<[f64; 3]> {
    let (numbers, _) = facet.as_chunks::<4>();
    let numbers: Vec<f64> = numbers.iter().map(|b| f64::from(f32::from_le_bytes(*b))).collect();
    // the first three numbers are the normal
    numbers.as_chunks::<3>().0.iter().skip(1).copied().collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const TRIANGLE: [[f64; 3]; 3] = [[0.0, 0.0, 0.5], [1.5, 0.0, 0.5], [0.0, -2.25, 1.0]];

    fn binary(header: &[u8], triangles: &[[[f64; 3]; 3]]) -> Vec<u8> {
        let mut bytes = header.to_vec();
        bytes.resize(80, b' ');
        bytes.extend((triangles.len() as u32).to_le_bytes());
        for t in triangles {
            let numbers = [0.0, 0.0, 1.0].into_iter().chain(t.iter().flatten().copied());
            bytes.extend(numbers.flat_map(|n| (n as f32).to_le_bytes()));
            bytes.extend([0, 0]);
        }
        bytes
    }

    fn text() -> String {
        let corners: String = TRIANGLE.iter().map(|[x, y, z]| format!("      vertex {x} {y:e} {z}\r\n")).collect();
        format!("solid body\n facet normal 0 0 1\n    outer loop\n{corners}    endloop\n endfacet\nendsolid body\n")
    }

    #[test]
    fn reads_the_vertex_lines_of_an_obj() {
        let obj =
            "# caf\u{e9}\nmtllib x.mtl\nv 0 0 0.5\n  v\t1.5 0.0 0.5 1.0\nvn 9 9 9\nvt 9 9\nv 0 -2.25 1\nf 1 2 3\n";
        assert_eq!(vertices(false, obj.as_bytes()).unwrap(), TRIANGLE);
        let mut latin = obj.as_bytes().to_vec();
        latin.splice(0..0, *b"# \xe9\xff\n");
        assert_eq!(vertices(false, &latin).unwrap(), TRIANGLE);
    }

    #[test]
    fn reads_the_facet_corners_of_text_and_binary_stl() {
        assert_eq!(vertices(true, text().as_bytes()).unwrap(), TRIANGLE);
        assert_eq!(vertices(true, &binary(b"made by hand", &[TRIANGLE])).unwrap(), TRIANGLE);
        assert_eq!(vertices(true, &binary(b"solid, but binary", &[TRIANGLE, TRIANGLE])).unwrap().len(), 6);
    }

    #[test]
    fn refuses_invalid_meshes() {
        let error = |is_stl, bytes: &[u8]| vertices(is_stl, bytes).unwrap_err();
        assert!(matches!(error(false, b""), MeshError::Empty));
        assert!(matches!(error(false, b"vn 0 0 1\nf 1 2 3"), MeshError::Empty));
        assert!(matches!(error(false, b"v 0 0 0\nv 1 two 3"), MeshError::Line { line: 2, .. }));
        assert!(matches!(error(false, b"v 0 0"), MeshError::Line { line: 1, .. }));
        assert!(matches!(error(false, b"v 0 0 0\nv 1 nan 3"), MeshError::NotFinite { vertex: 2 }));
        assert!(matches!(error(false, b"v 1e999 0 3"), MeshError::NotFinite { vertex: 1 }));
        assert!(matches!(error(true, b"solid x\nendsolid x"), MeshError::Empty));
        assert!(matches!(error(true, b""), MeshError::Truncated));
        assert!(matches!(error(true, &binary(b"", &[])), MeshError::Empty));
        let whole = binary(b"", &[TRIANGLE]);
        assert!(matches!(error(true, &whole[..whole.len() - 1]), MeshError::Truncated));
        let mut broken = whole.clone();
        broken[96..100].copy_from_slice(&f32::NAN.to_le_bytes());
        assert!(matches!(error(true, &broken), MeshError::NotFinite { vertex: 1 }));
        let mut wrong_count = whole;
        wrong_count[80..84].copy_from_slice(&u32::MAX.to_le_bytes());
        assert!(matches!(error(true, &wrong_count), MeshError::Truncated));
    }

    #[test]
    fn accepts_extensions_in_any_case_and_refuses_urls() {
        assert!(is_stl("meshes/body.STL").unwrap() && !is_stl("body.obj").unwrap());
        for name in ["body.dae", "body", "", "stl"] {
            assert!(matches!(is_stl(name), Err(MeshError::Kind)), "{name}");
        }
        assert!(matches!(is_stl("package://car/body.stl"), Err(MeshError::Address)));
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(2000))]
        /// Random bytes, and valid files with bytes changed, removed or added, give finite vertices or an error.
        #[test]
        fn random_bytes_never_panic(
            junk in prop::collection::vec(any::<u8>(), 0..300),
            base in 0..4usize, at in any::<prop::sample::Index>(), keep in any::<bool>(), is_stl in any::<bool>(),
        ) {
            let base = match base {
                0 => Vec::new(),
                1 => text().into_bytes(),
                2 => b"v 0 0 0\nv 1 0 0\nv 0 1 0\n".to_vec(),
                _ => binary(b"x", &[TRIANGLE]),
            };
            let cut = at.index(base.len() + 1);
            let end = if keep { (cut + junk.len()).min(base.len()) } else { base.len() };
            let bytes: Vec<u8> = base[..cut].iter().chain(&junk).chain(&base[end..]).copied().collect();
            if let Ok(found) = vertices(is_stl, &bytes) {
                prop_assert!(!found.is_empty() && found.iter().flatten().all(|c| c.is_finite()));
            }
        }
    }
}
