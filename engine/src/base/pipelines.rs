//! What a driver made of the kernels, on disk, so that the next run begins with it.
//!
//! It is a cache: whatever is wrong with it, a run does without and leaves a new one. Drivers trust what they are given
//! back, so that only files that are whole, of this user, and that nobody else can write to are read.

use std::fs::{self, File};
use std::io::Read as _;
use std::path::{Path, PathBuf};

use guard4d_kernels::registry;

use super::digest::Digest;
use super::output::{AtomicFile, Existing, create_private_dir};
use crate::device::Device;

/// First bytes of a file.
const MAGIC: &[u8; 8] = b"g4dpipe1";
/// Most bytes of a file that is read; all kernels together are a few MiB.
const MAX_BYTES: u64 = 256 << 20;
/// Bytes of what a driver writes that remembers nothing: the header that Vulkan asks for.
const EMPTY_BYTES: usize = 32;
const HASH_BYTES: usize = 32;

/// Has the driver of `device` begin with what an earlier run left in `folder`, and leaves there what this one adds when
/// the device goes.
pub fn remember(device: &Device, folder: &Path) {
    let path = folder.join(file_name(device));
    let program = program(device);
    let known = read(&path, &program).unwrap_or_else(|why| {
        tracing::debug!("no kernels from before: {}: {why}", path.display());
        Vec::new()
    });
    let before = Digest::of(&known);
    let keep = move |data: &[u8]| {
        if data.len() > EMPTY_BYTES && Digest::of(data) != before {
            write(&path, &program, data);
        }
    };
    if let Err(error) = device.remember_pipelines(&known, keep) {
        tracing::debug!("the driver remembers no kernels: {error}");
    }
}

/// One name for each device and driver.
fn file_name(device: &Device) -> PathBuf {
    let info = device.info();
    let whose = format!("{}\n{}\n{}\n{}\n", info.name, info.driver, info.uuid, device.family());
    PathBuf::from(format!("{}.pipelines", Digest::of(whose.as_bytes())))
}

/// Hash of all programs that the device can come to run.
fn program(device: &Device) -> Digest {
    let programs = registry::ALL.iter().filter_map(|kernel| kernel.program(device.family()));
    Digest::of(programs.collect::<Vec<_>>().concat().as_slice())
}

/// What was kept by the same program; else why there is nothing.
fn read(path: &Path, program: &Digest) -> Result<Vec<u8>, String> {
    let told = |error: std::io::Error| error.to_string();
    let file = File::open(path).map_err(told)?;
    let meta = file.metadata().map_err(told)?;
    if !meta.is_file() || meta.len() > MAX_BYTES {
        return Err("not a file that this program writes".to_owned());
    }
    let folder = path.parent().ok_or("no folder")?;
    if !(is_ours(&meta) && is_ours(&fs::metadata(folder).map_err(told)?)) {
        return Err("others can write to it".to_owned());
    }
    let mut bytes = Vec::new();
    file.take(MAX_BYTES).read_to_end(&mut bytes).map_err(told)?;
    let rest = bytes.strip_prefix(MAGIC).ok_or("not a file that this program writes")?;
    let (of_program, rest) = rest.split_at_checked(HASH_BYTES).ok_or("cut off")?;
    let (hash, data) = rest.split_at_checked(HASH_BYTES).ok_or("cut off")?;
    match (of_program == program.as_bytes(), hash == Digest::of(data).as_bytes()) {
        (true, true) => Ok(data.to_vec()),
        (false, _) => Err("of another version of this program".to_owned()),
        (_, false) => Err("cut off or changed".to_owned()),
    }
}

fn write(path: &Path, program: &Digest, data: &[u8]) {
    let bytes = [MAGIC, program.as_bytes().as_slice(), Digest::of(data).as_bytes(), data].concat();
    let folder = path.parent().unwrap_or(Path::new("."));
    let written = create_private_dir(folder).and_then(|()| AtomicFile::write_private(path, Existing::Replace, &bytes));
    match written {
        Ok(()) => tracing::debug!("{} bytes of kernels are kept in {}", data.len(), path.display()),
        Err(error) => tracing::debug!("no kernels are kept: {error}"),
    }
}

/// Whether a file or folder is this user's, and nobody else can write to it.
#[cfg(unix)]
fn is_ours(meta: &fs::Metadata) -> bool {
    use std::os::unix::fs::MetadataExt as _;
    meta.uid() == rustix::process::geteuid().as_raw() && meta.mode() & 0o022 == 0
}

/// Profiles of users are their own.
#[cfg(not(unix))]
fn is_ours(_: &fs::Metadata) -> bool {
    true
}

#[cfg(all(test, unix))]
mod tests {
    use std::os::unix::fs::PermissionsExt as _;

    use super::*;

    #[test]
    fn what_is_kept_is_read_by_the_same_program_and_user_alone() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("cache/some.pipelines");
        let (program, other, data) = (Digest::of(b"a"), Digest::of(b"b"), vec![7; 1000]);
        read(&path, &program).expect_err("nothing is there yet");
        write(&path, &program, &data);
        assert_eq!(read(&path, &program).as_deref(), Ok(data.as_slice()));
        assert!(read(&path, &other).is_err_and(|why| why.contains("another version")));

        let whole = fs::read(&path).expect("there");
        let mut changed = whole.clone();
        changed[500] ^= 1;
        for bad in [&whole[..0], &whole[..9], &whole[..60], &whole[..whole.len() - 1], &changed] {
            fs::write(&path, bad).expect("writable");
            read(&path, &program).expect_err("cut off or changed");
        }
        write(&path, &program, &data);
        read(&path, &program).expect("written anew");

        let allow = |path: &Path, mode| fs::set_permissions(path, fs::Permissions::from_mode(mode)).expect("ours");
        allow(&path, 0o620);
        assert!(read(&path, &program).is_err_and(|why| why.contains("others can write")));
        allow(&path, 0o600);
        allow(&folder.path().join("cache"), 0o777);
        assert!(read(&path, &program).is_err_and(|why| why.contains("others can write")), "nor to its folder");
        allow(&folder.path().join("cache"), 0o700);
        read(&path, &program).expect("ours alone");
        fs::remove_file(&path).expect("ours");
        fs::create_dir(&path).expect("writable");
        read(&path, &program).expect_err("a folder");
        write(&path, &program, &data);
    }
}
