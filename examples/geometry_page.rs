//! Writes the pictures of `docs/geometry.md` into a folder. Run it in the folder that contains `maps/`.
//!
//! `cargo run --release --example geometry_page -- docs/geometry`

use std::error::Error;
use std::path::{Path, PathBuf};

use stopline::io::commonroad::read_file;
use stopline::io::files::write_atomic;
use stopline::plot::geometry::pictures;
use stopline::vehicle::load;

fn main() -> Result<(), Box<dyn Error>> {
    let folder = PathBuf::from(std::env::args().nth(1).unwrap_or_else(|| "docs/geometry".into()));
    std::fs::create_dir_all(&folder)?;
    let slalom = read_file(Path::new("maps/slalom.xml"))?;
    for (name, svg) in pictures(&slalom, &load("bmw_320i")?) {
        write_atomic(&folder.join(name), svg.as_bytes())?;
        println!("{}", folder.join(name).display());
    }
    Ok(())
}
