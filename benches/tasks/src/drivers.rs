//! Vulkan drivers for the conformance tests, and how a program is made to load one alone.

use std::env;
use std::ffi::OsString;
use std::fs;
use std::path::{Path, PathBuf};

use clap::ValueEnum;

use crate::debian::{Apt, Wanted, unmet};
use crate::error::{Error, Naming, Result};
use crate::workspace::{Workspace, empty_folder, say};

/// A Vulkan driver.
#[derive(Clone, Copy, Debug, PartialEq, ValueEnum)]
pub(crate) enum Driver {
    /// The machine's own lavapipe
    Lavapipe,
    /// Lavapipe of Mesa 25, from Debian's backports
    #[value(name = "mesa-25")]
    Mesa25,
    /// Lavapipe of Mesa 26, which has cooperative matrices
    #[value(name = "mesa-26")]
    Mesa26,
    /// Google's SwiftShader, as Chromium brings it
    Swiftshader,
    /// What is installed
    System,
}

/// Variables that make programs load one driver.
pub(crate) type Environment = Vec<(&'static str, OsString)>;

/// A driver that this machine's programs can load, from Debian packages.
struct Unpacked {
    library: &'static str,
    /// Vulkan's version, for the loader.
    version: &'static str,
    packages: &'static [Wanted],
}

const MESA_25: Unpacked = Unpacked {
    library: "libvulkan_lvp.so",
    version: "1.4.305",
    packages: &[
        Wanted { package: "mesa-vulkan-drivers/bookworm-backports", files: "*/libvulkan_lvp.so" },
        Wanted { package: "libdrm2/bookworm-backports", files: "*/libdrm.so.2*" },
    ],
};

/// Mesa's driver for AMD GPUs, the newest that compiles for a GPU which is not there: those from 25.2 on want a kernel
/// module that pretends to be one.
const RADV_25: Unpacked = Unpacked {
    library: "libvulkan_radeon.so",
    version: "1.4.305",
    packages: &[
        Wanted { package: "mesa-vulkan-drivers/bookworm-backports", files: "*/libvulkan_radeon.so" },
        Wanted { package: "libdrm2/bookworm-backports", files: "*/libdrm.so.2*" },
        Wanted { package: "libdrm-amdgpu1/bookworm-backports", files: "*/libdrm_amdgpu.so.1*" },
    ],
};

const SWIFTSHADER: Unpacked = Unpacked {
    library: "libvk_swiftshader.so",
    version: "1.3.0",
    packages: &[Wanted { package: "chromium-common/bookworm", files: "*/libvk_swiftshader.so" }],
};

/// Mesa 26 is built for Debian trixie, so its C library comes along: no program of this machine's release can load it.
const MESA_26_PACKAGES: [&str; 5] =
    ["mesa-vulkan-drivers/trixie-backports", "vulkan-validationlayers", "libvulkan1", "libstdc++6", "libc6"];
const MESA_26_VERSION: &str = "1.4.354";
/// Where Debian has libraries for x86-64.
const LIBRARIES: &str = "usr/lib/x86_64-linux-gnu";

impl Driver {
    /// The name on the command line.
    pub(crate) fn name(self) -> String {
        self.to_possible_value().map(|value| value.get_name().to_owned()).unwrap_or_default()
    }

    /// What the machine needs for it, by the entry script's names. What lavapipe depends on, the others depend on too.
    pub(crate) fn wants(self) -> &'static str {
        if self == Self::System { "driver" } else { "lavapipe" }
    }

    /// Fetches the driver where it is not here yet. Returns what makes programs load it alone.
    pub(crate) fn prepare(self, workspace: &Workspace) -> Result<Environment> {
        let drivers = workspace.path("target/drivers");
        fs::create_dir_all(&drivers).of_file(&drivers)?;
        let folder = drivers.join(self.name());
        match self {
            Self::System => Ok(Vec::new()),
            Self::Lavapipe => Ok(found_by(&installed_lavapipe()?)),
            Self::Mesa25 => own_release(&MESA_25, &drivers, &folder),
            Self::Swiftshader => own_release(&SWIFTSHADER, &drivers, &folder),
            Self::Mesa26 => next_release(&drivers, &folder),
        }
    }
}

/// Fetches Mesa 25's driver for AMD GPUs where it is not here yet. Returns what makes programs load it alone.
pub(crate) fn radv_25(workspace: &Workspace) -> Result<Environment> {
    let drivers = workspace.path("target/drivers");
    fs::create_dir_all(&drivers).of_file(&drivers)?;
    own_release(&RADV_25, &drivers, &drivers.join("radv-25"))
}

/// Makes the loader find one driver alone. Loaders before 1.3.207 know the second name only.
pub(crate) fn found_by(manifest: &Path) -> Environment {
    ["VK_DRIVER_FILES", "VK_ICD_FILENAMES"].map(|name| (name, manifest.into())).into()
}

fn installed_lavapipe() -> Result<PathBuf> {
    let folder = Path::new("/usr/share/vulkan/icd.d");
    let entries = fs::read_dir(folder).of_file(folder)?;
    let mut names: Vec<_> = entries.filter_map(|entry| Some(entry.ok()?.path())).collect();
    names.retain(|path| {
        let name = path.file_name().unwrap_or_default().to_string_lossy();
        name.starts_with("lvp_icd") && name.ends_with(".json")
    });
    names.sort();
    names.into_iter().next().ok_or_else(|| Error::Missing("lavapipe is not installed".to_owned()))
}

/// The loader's manifest of a driver.
fn manifest(library: &str, version: &str) -> String {
    let about = serde_json::json!({
        "file_format_version": "1.0.0",
        "ICD": { "library_path": library, "api_version": version },
    });
    format!("{about}\n")
}

fn write_packages(folder: &Path, packages: &[String]) -> Result<()> {
    let path = folder.join("packages.txt");
    fs::write(&path, packages.join("\n") + "\n").of_file(&path)
}

fn tell_packages(folder: &Path) -> Result<()> {
    let path = folder.join("packages.txt");
    let packages = fs::read_to_string(&path).of_file(&path)?;
    say(&format!("driver from {}", packages.lines().collect::<Vec<_>>().join(" ")));
    Ok(())
}

/// A driver of this machine's release.
fn own_release(driver: &Unpacked, drivers: &Path, folder: &Path) -> Result<Environment> {
    let icd = folder.join("icd.json");
    if !icd.exists() {
        let apt = Apt::new(drivers.join("apt"), &["bookworm", "bookworm-backports"])?;
        empty_folder(folder)?;
        let packages: Result<Vec<_>> = driver.packages.iter().map(|wanted| apt.unpack_files(wanted, folder)).collect();
        write_packages(folder, &packages?)?;
        apt.remove()?;
        // Last, for it says that the rest is there.
        fs::write(&icd, manifest(&format!("./{}", driver.library), driver.version)).of_file(&icd)?;
    }
    tell_packages(folder)?;
    let mut search = folder.as_os_str().to_owned();
    if let Some(before) = env::var_os("LD_LIBRARY_PATH").filter(|before| !before.is_empty()) {
        search.push(":");
        search.push(before);
    }
    let missing = unmet(&folder.join(driver.library), &search)?;
    if !missing.is_empty() {
        return Err(Error::Missing(format!("{} finds no {}", driver.library, missing.join(" "))));
    }
    let mut environment = found_by(&icd);
    environment.push(("LD_LIBRARY_PATH", search));
    Ok(environment)
}

/// Mesa 26. Programs that cargo starts run in Debian trixie's C library, with its driver and its validation layers.
fn next_release(drivers: &Path, folder: &Path) -> Result<Environment> {
    let (icd, libraries) = (folder.join("icd.json"), folder.join(LIBRARIES));
    if !icd.exists() {
        if env::consts::ARCH != "x86_64" {
            return Err(Error::Missing("the driver mesa-26 is unpacked for x86-64 only".to_owned()));
        }
        let apt = Apt::new(drivers.join("apt"), &["trixie", "trixie-backports"])?;
        empty_folder(folder)?;
        let mut packages = apt.unpack_all(&MESA_26_PACKAGES, folder)?;
        packages.retain(|package| package.starts_with("mesa-vulkan-drivers_"));
        write_packages(folder, &packages)?;
        apt.remove()?;
        let library = libraries.join("libvulkan_lvp.so").display().to_string();
        fs::write(&icd, manifest(&library, MESA_26_VERSION)).of_file(&icd)?;
    }
    tell_packages(folder)?;
    let runner = format!("{0}/ld-linux-x86-64.so.2 --library-path {0}", libraries.display());
    Ok(vec![
        ("CARGO_TARGET_X86_64_UNKNOWN_LINUX_GNU_RUNNER", runner.into()),
        ("VK_DRIVER_FILES", icd.into()),
        ("VK_LAYER_PATH", folder.join("usr/share/vulkan/explicit_layer.d").into()),
        // Layers of that age follow what kernels touch only when asked to.
        ("VK_KHRONOS_VALIDATION_SYNCVAL_SHADER_ACCESSES_HEURISTIC", "true".into()),
        // What this driver is here for must not be skipped.
        ("GUARD4D_REQUIRE_F16", "1".into()),
    ])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn drivers_have_their_names_on_the_command_line() {
        let names: Vec<_> = Driver::value_variants().iter().map(|driver| driver.name()).collect();
        assert_eq!(names, ["lavapipe", "mesa-25", "mesa-26", "swiftshader", "system"]);
        for name in names {
            assert_eq!(Driver::from_str(&name, false).map(Driver::name), Ok(name));
        }
    }

    #[test]
    fn packages_name_a_suite_that_apt_knows() {
        let wanted = [&MESA_25, &RADV_25, &SWIFTSHADER].into_iter().flat_map(|driver| driver.packages);
        for package in wanted.map(|wanted| wanted.package) {
            let suite = package.split_once('/').expect("NAME/SUITE").1;
            assert!(["bookworm", "bookworm-backports"].contains(&suite), "{package}");
        }
        let suites: Vec<_> = MESA_26_PACKAGES.iter().filter_map(|package| package.split_once('/')).collect();
        assert_eq!(suites, [("mesa-vulkan-drivers", "trixie-backports")], "the others are of the release");
    }

    #[test]
    fn the_loader_reads_the_manifest() {
        let text = manifest("./lib \"a\".so", "1.3.0");
        let read: serde_json::Value = serde_json::from_str(&text).expect("JSON");
        assert_eq!(read["ICD"]["library_path"], "./lib \"a\".so");
        assert_eq!(read["ICD"]["api_version"], "1.3.0");
    }
}
