//! Writes the pictures of `docs/geometry.md` into a folder.
//!
//! `cargo run --release --example geometry_page -- docs/geometry`

use std::error::Error;
use std::path::PathBuf;

use stopline::io::files::write_atomic;
use stopline::plot::geometry::pictures;

fn main() -> Result<(), Box<dyn Error>> {
    let folder = PathBuf::from(std::env::args().nth(1).unwrap_or_else(|| "docs/geometry".into()));
    std::fs::create_dir_all(&folder)?;
    for (name, svg) in pictures() {
        write_atomic(&folder.join(name), svg.as_bytes())?;
        println!("{}", folder.join(name).display());
    }
    Ok(())
}
