//! The vertices of mesh files: Wavefront OBJ and STL, text and binary.
//!
//! Only positions are read, since all that is wanted is their hull on the ground: `v` lines of an OBJ, the corners of the
//! facets of an STL. Faces, normals, materials and units are passed over. STL files often say `solid` though they are
//! binary: a file whose length is that of a binary one with its number of facets is one.

/// Bytes of a mesh file at most: a footprint needs a few hundred vertices.
pub(super) const MOST_BYTES: u64 = 64 << 20;

/// Why a mesh has no vertices to give.
#[derive(Debug, thiserror::Error)]
pub enum MeshError {
    /// An address like `package://…`, which needs a ROS installation.
    #[error("an address; expected the name of a file beside the URDF")]
    Address,
    /// A kind of file that is not read.
    #[error("unknown kind of mesh; expected .obj or .stl")]
    Kind,
    /// Missing, or not to be read.
    #[error("cannot be read: {0}")]
    Unreadable(#[from] std::io::Error),
    /// A large file.
    #[error("larger than {} MiB; expected a simple mesh for collision", MOST_BYTES >> 20)]
    TooLarge,
    /// A line that is no vertex though it says so.
    #[error("line {line}: `{found}`; expected three numbers")]
    Line {
        /// Counted from 1.
        line: usize,
        /// Its beginning.
        found: String,
    },
    /// Neither a text STL nor a binary one of the length that it announces.
    #[error("neither a text STL nor a whole binary one")]
    Truncated,
    /// A coordinate that is not finite.
    #[error("vertex {vertex} is not finite")]
    NotFinite {
        /// Counted from 1.
        vertex: usize,
    },
    /// No vertices.
    #[error("no vertices")]
    Empty,
}

/// Checks a mesh's name; whether it is an STL (else an OBJ).
pub(super) fn is_stl(name: &str) -> Result<bool, MeshError> {
    if name.contains("://") {
        return Err(MeshError::Address);
    }
    let is = |extension: &str| {
        std::path::Path::new(name).extension().is_some_and(|found| found.eq_ignore_ascii_case(extension))
    };
    if is("stl") {
        Ok(true)
    } else if is("obj") {
        Ok(false)
    } else {
        Err(MeshError::Kind)
    }
}

/// The vertices in a file's bytes.
pub(super) fn vertices(is_stl: bool, bytes: &[u8]) -> Result<Vec<[f64; 3]>, MeshError> {
    let found = if !is_stl {
        from_lines(bytes, "v")?
    } else if let Some(facets) = binary_facets(bytes) {
        facets.iter().flat_map(facet_corners).collect()
    } else if bytes.trim_ascii_start().starts_with(b"solid") {
        from_lines(bytes, "vertex")?
    } else {
        return Err(MeshError::Truncated);
    };
    if let Some(i) = found.iter().position(|v| !v.iter().all(|c| c.is_finite())) {
        return Err(MeshError::NotFinite { vertex: i + 1 });
    }
    if found.is_empty() { Err(MeshError::Empty) } else { Ok(found) }
}

/// The numbers of all lines that begin with a keyword.
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

/// Bytes of one facet of a binary STL: normal, three corners, two bytes more.
const FACET: usize = 50;

/// The facets of a binary STL, if the bytes have the length of one.
fn binary_facets(bytes: &[u8]) -> Option<&[[u8; FACET]]> {
    let (count, facets) = bytes.get(80..)?.split_first_chunk::<4>()?;
    let (facets, rest) = facets.as_chunks::<FACET>();
    (rest.is_empty() && u32::try_from(facets.len()).ok()? == u32::from_le_bytes(*count)).then_some(facets)
}

fn facet_corners(facet: &[u8; FACET]) -> Vec<[f64; 3]> {
    let (numbers, _) = facet.as_chunks::<4>();
    let numbers: Vec<f64> = numbers.iter().map(|b| f64::from(f32::from_le_bytes(*b))).collect();
    // the first three are the normal
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
    fn obj_gives_its_v_lines_and_nothing_else() {
        let obj =
            "# caf\u{e9}\nmtllib x.mtl\nv 0 0 0.5\n  v\t1.5 0.0 0.5 1.0\nvn 9 9 9\nvt 9 9\nv 0 -2.25 1\nf 1 2 3\n";
        assert_eq!(vertices(false, obj.as_bytes()).unwrap(), TRIANGLE);
        let mut latin = obj.as_bytes().to_vec();
        latin.splice(0..0, *b"# \xe9\xff\n");
        assert_eq!(vertices(false, &latin).unwrap(), TRIANGLE);
    }

    #[test]
    fn stl_gives_the_corners_of_its_facets_from_text_and_binary() {
        assert_eq!(vertices(true, text().as_bytes()).unwrap(), TRIANGLE);
        assert_eq!(vertices(true, &binary(b"made by hand", &[TRIANGLE])).unwrap(), TRIANGLE);
        assert_eq!(vertices(true, &binary(b"solid, but binary", &[TRIANGLE, TRIANGLE])).unwrap().len(), 6);
    }

    #[test]
    fn what_is_no_mesh_is_told_apart() {
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
        let mut announced = whole;
        announced[80..84].copy_from_slice(&u32::MAX.to_le_bytes());
        assert!(matches!(error(true, &announced), MeshError::Truncated));
    }

    #[test]
    fn names_tell_the_kind_in_any_case_and_addresses_are_refused() {
        assert!(is_stl("meshes/body.STL").unwrap() && !is_stl("body.obj").unwrap());
        for name in ["body.dae", "body", "", "stl"] {
            assert!(matches!(is_stl(name), Err(MeshError::Kind)), "{name}");
        }
        assert!(matches!(is_stl("package://car/body.stl"), Err(MeshError::Address)));
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(2000))]
        /// Any bytes, and good files with bytes changed, cut or added, give finite vertices or an error.
        #[test]
        fn no_bytes_make_it_panic(
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
