//! What `./x` hands on: the tasks around guard4d that are more than a line. `./x help` lists all of them.

mod archives;
mod bare;
mod book;
mod conformance;
mod counts;
mod debian;
mod docs;
mod drivers;
mod error;
mod farm;
mod fuzz;
mod gpu;
mod interop;
mod isa;
mod licences;
mod needed;
mod package;
mod peers;
mod pinned;
mod process;
mod programs;
mod shaderc;
mod workspace;

use std::path::PathBuf;
use std::process::ExitCode;

use clap::{Parser, Subcommand};

use error::Result;
use workspace::{Workspace, say};

#[derive(Parser)]
#[command(name = "./x", bin_name = "./x", about = "Tasks around guard4d; `./x help` lists all of them")]
struct Arguments {
    /// The checkout to work in
    #[arg(long, hide = true, default_value = concat!(env!("CARGO_MANIFEST_DIR"), "/../.."))]
    root: PathBuf,
    #[command(subcommand)]
    task: Task,
}

#[derive(Subcommand)]
enum Task {
    Conformance(conformance::ConformanceArgs),
    Docs(docs::DocsArgs),
    Farm(farm::task::FarmArgs),
    Fuzz(fuzz::FuzzArgs),
    Gpu(gpu::GpuArgs),
    Interop(interop::InteropArgs),
    Isa(isa::IsaArgs),
    Package(package::PackageArgs),
    Peers(peers::PeersArgs),
    Shaderc(shaderc::ShadercArgs),
}

fn run(arguments: &Arguments) -> Result<()> {
    let workspace = Workspace::new(arguments.root.clone());
    match &arguments.task {
        Task::Conformance(args) => conformance::run(&workspace, args),
        Task::Docs(args) => docs::run(&workspace, args),
        Task::Farm(args) => farm::task::run(&workspace, args),
        Task::Fuzz(args) => fuzz::run(&workspace, args),
        Task::Gpu(args) => gpu::run(&workspace, args),
        Task::Interop(args) => interop::run(&workspace, args),
        Task::Isa(args) => isa::run(&workspace, args),
        Task::Package(args) => package::run(&workspace, args),
        Task::Peers(args) => peers::run(&workspace, args),
        Task::Shaderc(args) => shaderc::run(&workspace, args),
    }
}

fn main() -> ExitCode {
    match run(&Arguments::parse()) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            if !error.is_told() {
                say(&error.to_string());
            }
            ExitCode::from(error.exit_code())
        }
    }
}
