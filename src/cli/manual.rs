//! Shell completions and manual pages, generated from the definitions of the arguments.

use std::path::Path;

use clap::CommandFactory as _;
use clap_mangen::Man;

use super::args::Args;
use super::{Exit, Failure, print};
use crate::io::files;

/// Prints the completion script of a shell.
pub(super) fn completions(shell: clap_complete::Shell) -> Result<Exit, Failure> {
    let mut script = Vec::new();
    clap_complete::generate(shell, &mut Args::command(), "stopline", &mut script);
    print(&String::from_utf8_lossy(&script)).map(|()| Exit::Pass)
}

/// Prints the manual page of the program, or writes one page per command to a folder.
pub(super) fn man(folder: Option<&Path>) -> Result<Exit, Failure> {
    let mut command = Args::command().disable_help_subcommand(true);
    command.build();
    match folder {
        Some(folder) => {
            let created = std::fs::create_dir_all(folder);
            created.map_err(|e| Failure::File(format!("--out {}: cannot be created: {e}", folder.display())))?;
            write_pages(&command, folder)?;
        }
        None => print(&String::from_utf8_lossy(&roff(&page(&command))?))?,
    }
    Ok(Exit::Pass)
}

/// The manual page of a command.
fn page(command: &clap::Command) -> Man {
    Man::new(command.clone()).source(concat!("stopline ", env!("CARGO_PKG_VERSION")))
}

fn roff(page: &Man) -> Result<Vec<u8>, Failure> {
    let mut bytes = Vec::new();
    page.render(&mut bytes).map_err(|e| Failure::Fault(format!("a manual page cannot be rendered: {e}")))?;
    Ok(bytes)
}

/// Writes the pages of a command and of its subcommands.
fn write_pages(command: &clap::Command, folder: &Path) -> Result<(), Failure> {
    let page = page(command);
    let file = folder.join(page.get_filename());
    files::write_atomic(&file, &roff(&page)?).map_err(|e| Failure::File(format!("--out {e}")))?;
    command.get_subcommands().filter(|sub| !sub.is_hide_set()).try_for_each(|sub| write_pages(sub, folder))
}
