//! The command line: arguments, a job, a report.
//!
//! `args` defines the commands and flags. `job` reads and checks every input, and makes sure that every output can be
//! written, before anything starts. `engine` runs the job; it is the only file of this module that knows planner and
//! simulation. `report` prints the result. `check` and `bench` have their own reports. `manual` generates shell completions
//! and manual pages. Results go to stdout, everything else to stderr.
//!
//! The exit code is the result of the program, [`Exit`]: outcomes are not errors.

mod args;
mod bench;
mod check;
mod engine;
mod job;
mod manual;
mod progress;
mod report;

use std::ffi::OsString;
use std::io::Write as _;
use std::process::ExitCode;

use clap::error::{ContextKind, ContextValue, ErrorKind};
use clap::{CommandFactory as _, Parser as _};

use args::Command;
use job::Job;

use crate::result::json;

/// The exit codes, as published in `--help`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Exit {
    /// The run ended and every check passed; or help was asked for.
    Pass = 0,
    /// The run ended and a check failed, or no safe plan exists.
    CheckFailed = 1,
    /// Wrong use: unknown options, values out of range, options that exclude each other.
    WrongUse = 2,
    /// An input is unreadable or invalid, or an output cannot be written.
    BadFile = 3,
    /// A fault of the program itself.
    OwnFault = 4,
    /// Ctrl-C interrupted `check`: 128 + SIGINT, as shells report it.
    Interrupted = 130,
}

impl From<Exit> for ExitCode {
    fn from(exit: Exit) -> Self {
        Self::from(exit as u8)
    }
}

/// Why a command did not run to its report.
#[derive(Debug, thiserror::Error)]
enum Failure {
    /// Exit code 2.
    #[error("{0}")]
    Use(String),
    /// Exit code 3.
    #[error("{0}")]
    File(String),
    /// Exit code 4.
    #[error("{0}; this is a fault of stopline itself")]
    Fault(String),
}

impl Failure {
    /// An invalid input or an output that cannot be written.
    fn file(error: impl std::fmt::Display) -> Self {
        Self::File(error.to_string())
    }

    fn exit(&self) -> Exit {
        match self {
            Self::Use(_) => Exit::WrongUse,
            Self::File(_) => Exit::BadFile,
            Self::Fault(_) => Exit::OwnFault,
        }
    }
}

/// Runs the program on its arguments (the program's name first).
pub fn run(arguments: impl IntoIterator<Item = OsString>) -> Exit {
    let arguments: Vec<OsString> = arguments.into_iter().collect();
    let args = match args::Args::try_parse_from(&arguments) {
        Ok(args) => args,
        Err(message) => {
            let message = with_owner(message, arguments.get(1));
            // help goes to stdout, errors to stderr; a closed pipe is no error
            let _ = message.print();
            return if message.use_stderr() { Exit::WrongUse } else { Exit::Pass };
        }
    };
    let ran = match args.command {
        Command::Plan(args) => Job::plan(args).and_then(|job| report_on(&job)),
        Command::Drive(args) => Job::drive(args).and_then(|job| report_on(&job)),
        Command::Check(args) => check::run(&args),
        Command::Bench(args) => bench::run(args.comparison),
        Command::Completions { shell } => manual::completions(shell),
        Command::Man { out } => manual::man(out.as_deref()),
    };
    ran.unwrap_or_else(|failure| {
        say(&format!("error: {failure}"));
        failure.exit()
    })
}

/// An error about a flag that another command has, with that command's name.
fn with_owner(mut error: clap::Error, command: Option<&OsString>) -> clap::Error {
    let Some(ContextValue::String(flag)) = error.get(ContextKind::InvalidArg).cloned() else { return error };
    let Some(name) = flag.strip_prefix("--").filter(|_| error.kind() == ErrorKind::UnknownArgument) else {
        return error;
    };
    let program = args::Args::command();
    let has_flag = |command: &clap::Command| command.get_arguments().any(|a| a.get_long() == Some(name));
    let owners = program.get_subcommands().flat_map(|command| {
        let own = (command.get_name().to_owned(), command);
        let within = |sub| (format!("{} {}", command.get_name(), clap::Command::get_name(sub)), sub);
        std::iter::once(own).chain(command.get_subcommands().map(within))
    });
    let Some((owner, _)) = owners.into_iter().find(|(_, command)| has_flag(command)) else { return error };
    let is_drive_only = owner == "drive" && command.is_some_and(|typed| typed == "plan");
    let reason = if is_drive_only { "; `stopline plan` runs no simulation" } else { "" };
    let tip = format!("{flag} is a flag of `stopline {owner}`{reason}");
    error.remove(ContextKind::SuggestedArg);
    error.insert(ContextKind::Suggested, ContextValue::StyledStrs(vec![tip.into()]));
    error
}

/// Runs the job, writes its outputs, prints the report.
fn report_on(job: &Job) -> Result<Exit, Failure> {
    if !job.quiet {
        report::issues(job).iter().for_each(|line| say(line));
    }
    let run = engine::execute(job)?;
    let result = engine::result_of(job, &run);
    engine::write_outputs(job, &run, &result)?;
    if job.outputs.json_on_stdout() {
        print(&json::text(&result.json))?;
    } else if !job.quiet {
        print(&report::text(&run, &result))?;
    }
    Ok(if result.result.pass { Exit::Pass } else { Exit::CheckFailed })
}

/// Calls `command` and turns a panic into [`Exit::OwnFault`]. The panic's message is on stderr already.
pub fn guarded(command: impl FnOnce() -> Exit + std::panic::UnwindSafe) -> Exit {
    std::panic::catch_unwind(command).unwrap_or_else(|_| {
        say(
            "error: stopline has a fault: the message above says where. Please report it with the file that led to it.",
        );
        Exit::OwnFault
    })
}

/// Prints a line on stderr. A failure to do so has nowhere to be reported.
fn say(line: &str) {
    let _ = writeln!(std::io::stderr(), "{line}");
}

/// Prints text on stdout. A closed pipe is no error: its reader has read enough.
fn print(text: &str) -> Result<(), Failure> {
    let mut stdout = std::io::stdout().lock();
    match stdout.write_all(text.as_bytes()).and_then(|()| stdout.flush()) {
        Err(e) if e.kind() != std::io::ErrorKind::BrokenPipe => {
            Err(Failure::File(format!("stdout: cannot be written: {e}")))
        }
        _ => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_panic_exits_with_own_fault() {
        assert_eq!(guarded(|| panic!("panic of a test")), Exit::OwnFault);
        assert_eq!(guarded(|| Exit::CheckFailed), Exit::CheckFailed);
    }

    #[test]
    fn each_failure_has_its_exit_code() {
        let codes = [Failure::Use(String::new()), Failure::File(String::new()), Failure::Fault(String::new())];
        assert_eq!(codes.map(|f| f.exit() as u8), [2, 3, 4]);
        assert_eq!([Exit::Pass as u8, Exit::CheckFailed as u8], [0, 1]);
    }
}
