//! The program: see [`stopline::cli`].

fn main() -> std::process::ExitCode {
    stopline::cli::guarded(|| stopline::cli::run(std::env::args_os())).into()
}
