//! `guard4d disclose`: one asset can be verified by others, and nothing else of the owner's is given away.

use std::ffi::OsStr;
use std::fs;

use guard4d_engine::base::tensor_file::TensorFile;

use super::controls::Rigged;
use super::{guard4d, names, scratch};
use crate::support::gpu::device;

#[test]
fn a_third_party_verifies_one_asset_without_the_owners_secret() {
    let Some(gpu) = device() else { return };
    let (rigged, folder) = (Rigged::get(&gpu), scratch());
    let (owner, out) = (rigged.file("owner.key"), folder.path().join("disclosed"));
    let receipt = rigged.file("private/receipt.json");
    let args: [&dyn AsRef<OsStr>; 7] = [&"disclose", &"--key", &owner, &"--receipt", &receipt, &"--out", &out];
    guard4d(&args).done();
    assert_eq!(names(&out), ["asset.key", "extractor.safetensors", "receipt.json"], "what was handed over");
    #[cfg(unix)]
    {
        let mode = std::os::unix::fs::PermissionsExt::mode(&fs::metadata(&out).expect("written").permissions());
        assert_eq!(mode & 0o777, 0o700, "what the secret of an asset lies in");
    }
    let key = out.join("asset.key");
    let (film, theirs) = (rigged.file("suspect"), out.join("receipt.json"));
    let verify: [&dyn AsRef<OsStr>; 7] = [&"verify", &film, &"--key", &key, &"--receipt", &theirs, &"--json"];
    let run = guard4d(&verify);
    assert_eq!(run.code, 0, "{}{}", run.stdout, run.stderr);
    let (here, there) = (rigged.verify(0, &[]), serde_json::from_str::<serde_json::Value>(&run.stdout).expect("JSON"));
    assert_eq!(here["evidence"], there["evidence"], "the same evidence with either key");

    let (secret, disclosed) = (TensorFile::read(&owner).expect("a key"), TensorFile::read(&key).expect("a key"));
    let secret = secret.text("secret").expect("the master secret");
    assert!(disclosed.meta.values().all(|text| text != secret), "the master secret stays where it is");
    let shown = guard4d(&[&"inspect", &key]);
    shown.done();
    for name in ["asset_secret", "reader_secret"] {
        let secret = disclosed.text(name).expect("a secret of the asset");
        assert!(!shown.stdout.contains(secret), "{name} is shown: {}", shown.stdout);
    }
    guard4d(&args).refused(73, &["disclosed: cannot create", "it exists"]);
    // It opens nothing else: no copy is marked with it, and nothing is signed.
    let unpacked = guard4d_engine::scene::demo::DemoScene::unpack().expect("the scene unpacks");
    let marked = folder.path().join("marked");
    let words = "--steps 1 --train-clips 2 --probes 32 --size 32x32 --orbit 1 --frames 2 --min-accuracy 0 --quiet";
    let scene = unpacked.path();
    let mut embed: Vec<&dyn AsRef<OsStr>> = vec![&"embed", &scene, &"--key", &key, &"--out", &marked];
    let words: Vec<&str> = words.split(' ').collect();
    embed.extend(words.iter().map(|word| word as &dyn AsRef<OsStr>));
    guard4d(&embed).refused(2, &["key of a delivery: a disclosed key", "the owner's key of the asset"]);
    assert!(!marked.exists(), "nothing is written");
}

/// Whoever shares the machine cannot read what an owner keeps.
#[cfg(unix)]
#[test]
fn keys_and_private_folders_are_their_owners_alone() {
    use std::os::unix::fs::PermissionsExt as _;
    let Some(gpu) = device() else { return };
    let owner = crate::support::owner::delivered(&gpu);
    let mode = |name: &str| fs::metadata(owner.join(name)).expect("it is there").permissions().mode() & 0o777;
    assert_eq!(mode("out/private"), 0o700, "the private folder");
    for name in ["owner.key", "out/private/extractor.safetensors", "out/private/undo.safetensors"] {
        assert_eq!(mode(name), 0o600, "{name}");
    }
    assert_ne!(mode("out/marked") & 0o055, 0, "what is handed out can be read");
}
