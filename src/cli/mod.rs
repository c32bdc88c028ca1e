//! The command line: arguments → job → report.
//!
//! `args` is what can be typed. `job` makes of it something that can run: every input read and checked, every output
//! known to be writable, before anything starts. `engine` runs it, the only file that knows planner and physics.
//! `report` says what happened. `bench` holds the comparisons, one file each, and `check` the
//! suites, which need no job. Results go to stdout,
//! everything else to stderr.
//!
//! What happened is in the exit code, [`Exit`]: outcomes are not errors.

mod args;
mod bench;
mod check;
mod engine;
mod job;
mod progress;
mod report;

use std::ffi::OsString;
use std::io::Write as _;
use std::process::ExitCode;

use clap::Parser as _;

use args::Command;
use job::{Job, Kind};

use crate::result::json;

/// The exit codes, as published in `--help`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Exit {
    /// It ran, and every check passed; or help was asked for.
    Pass = 0,
    /// It ran, and a check failed: unsafe, uncomfortable, no plan.
    CheckFailed = 1,
    /// Wrong use: unknown options, options that exclude each other.
    WrongUse = 2,
    /// An input is unreadable or invalid, or an output cannot be written.
    BadFile = 3,
    /// The program's own fault.
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
    /// An input that is wrong or an output that cannot be written.
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
    let args = match args::Args::try_parse_from(arguments) {
        Ok(args) => args,
        Err(message) => {
            // Help goes to stdout, complaints to stderr; a closed pipe changes nothing.
            let _ = message.print();
            return if message.use_stderr() { Exit::WrongUse } else { Exit::Pass };
        }
    };
    let ran = match args.command {
        Command::Plan(args) => Job::new(Kind::Plan, args).and_then(|job| report_on(&job)),
        Command::Drive(args) => Job::new(Kind::Drive, args).and_then(|job| report_on(&job)),
        Command::Check(args) => check::run(&args),
        Command::Bench(args) => bench::run(args.comparison),
    };
    ran.unwrap_or_else(|failure| {
        say(&format!("error: {failure}"));
        failure.exit()
    })
}

/// Runs the job, writes the outputs that it asks for, reports.
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

/// Calls `command` and turns a panic, whose message is on stderr already, into [`Exit::OwnFault`].
pub fn guarded(command: impl FnOnce() -> Exit + std::panic::UnwindSafe) -> Exit {
    std::panic::catch_unwind(command).unwrap_or_else(|_| {
        say(
            "error: stopline has a fault: the message above says where. Please report it with the file that led to it.",
        );
        Exit::OwnFault
    })
}

/// A line on stderr. If nobody can read it, there is nobody to tell.
fn say(line: &str) {
    let _ = writeln!(std::io::stderr(), "{line}");
}

/// Text on stdout. A reader that has seen enough and closed the pipe is no error.
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
    fn a_panic_is_the_programs_own_fault_and_nothing_else_is() {
        assert_eq!(guarded(|| panic!("a test of what a panic gives")), Exit::OwnFault);
        assert_eq!(guarded(|| Exit::CheckFailed), Exit::CheckFailed);
    }

    #[test]
    fn every_failure_has_its_code() {
        let codes = [Failure::Use(String::new()), Failure::File(String::new()), Failure::Fault(String::new())];
        assert_eq!(codes.map(|f| f.exit() as u8), [2, 3, 4]);
        assert_eq!([Exit::Pass as u8, Exit::CheckFailed as u8], [0, 1]);
    }
}
