//! Time-stamping authorities, made of the program `openssl`.

use std::ffi::OsStr;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use guard4d_engine::release::receipt::Receipt;
use tempfile::TempDir;

/// Kinds of keys, as `openssl genpkey` takes them.
pub(crate) const RSA: [&str; 4] = ["-algorithm", "RSA", "-pkeyopt", "rsa_keygen_bits:2048"];
pub(crate) const P256: [&str; 4] = ["-algorithm", "EC", "-pkeyopt", "ec_paramgen_curve:P-256"];
pub(crate) const P384: [&str; 4] = ["-algorithm", "EC", "-pkeyopt", "ec_paramgen_curve:P-384"];

/// Sections of certificates' extensions, and how dates are given.
const CONFIG: &str = "
[req]
distinguished_name = dn
x509_extensions = ca
prompt = no
[dn]
CN = nobody
[ca]
basicConstraints = critical,CA:TRUE
keyUsage = critical,keyCertSign
[short]
basicConstraints = critical,CA:TRUE,pathlen:0
[stamps]
basicConstraints = CA:FALSE
keyUsage = critical,digitalSignature
extendedKeyUsage = critical,timeStamping
[lax]
extendedKeyUsage = timeStamping
[web]
extendedKeyUsage = critical,timeStamping,serverAuth
[bare]
basicConstraints = CA:FALSE
[unknown]
extendedKeyUsage = critical,timeStamping
1.2.3.4.5 = critical,ASN1:NULL
[encrypts]
keyUsage = critical,keyEncipherment
extendedKeyUsage = critical,timeStamping
[tsa]
serial = serial
default_policy = 1.2.3.4.1
digests = sha256
accuracy = secs:1, millisecs:500
";

/// Whether openssl is here; without it a test is skipped, or fails where nothing may be skipped.
pub(crate) fn has_openssl() -> bool {
    let found = Command::new("openssl").arg("version").output().is_ok_and(|out| out.status.success());
    if !found {
        super::skipped_unless_required("openssl is not here");
    }
    found
}

/// A folder with the certificates of an authority that issues, `ca.pem`, and of one that stamps, `tsa.pem`.
pub(crate) struct Authority {
    folder: TempDir,
}

impl Authority {
    /// Both with keys of one kind; dates are signed with `hash`.
    pub(crate) fn new(kind: [&str; 4], hash: &str) -> Self {
        let authority = Self { folder: tempfile::tempdir().expect("a temporary folder can be made") };
        let config = format!("{CONFIG}signer_digest = {hash}\n");
        authority.put("openssl.cnf", config.as_bytes());
        authority.put("serial", b"01");
        authority.key(kind, "ca");
        authority.openssl(&[
            "req",
            "-x509",
            "-config",
            "openssl.cnf",
            "-key",
            "ca.key",
            "-subj",
            "/CN=Root of tests",
            "-days",
            "3650",
            "-out",
            "ca.pem",
        ]);
        authority.key(kind, "tsa");
        authority.certify("tsa", "stamps", "ca");
        authority
    }

    pub(crate) fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    pub(crate) fn put(&self, name: &str, bytes: &[u8]) -> PathBuf {
        let path = self.path(name);
        fs::write(&path, bytes).expect("a temporary folder is writable");
        path
    }

    /// Runs openssl in the folder; it has to end well.
    #[track_caller]
    pub(crate) fn openssl<S: AsRef<OsStr>>(&self, args: &[S]) -> String {
        let run = Command::new("openssl").args(args).current_dir(self.folder.path()).output().expect("openssl starts");
        let said = String::from_utf8_lossy(&run.stderr);
        assert!(run.status.success(), "openssl: {said}");
        String::from_utf8_lossy(&run.stdout).into_owned() + &said
    }

    pub(crate) fn key(&self, kind: [&str; 4], name: &str) {
        let file = format!("{name}.key");
        self.openssl(&[&["genpkey"], &kind[..], &["-out", &file]].concat());
    }

    /// Issues `name.pem` for `name.key`, with the extensions of a section, signed by `issuer`.
    pub(crate) fn certify(&self, name: &str, section: &str, issuer: &str) {
        let [key, request, out] = ["key", "csr", "pem"].map(|end| format!("{name}.{end}"));
        let [issuer_key, issuer] = ["key", "pem"].map(|end| format!("{issuer}.{end}"));
        let subject = format!("/O=Tests/CN=The {name}");
        self.openssl(&["req", "-new", "-config", "openssl.cnf", "-key", &key, "-subj", &subject, "-out", &request]);
        self.openssl(&[
            "x509",
            "-req",
            "-in",
            &request,
            "-CA",
            &issuer,
            "-CAkey",
            &issuer_key,
            "-CAcreateserial",
            "-days",
            "3650",
            "-extfile",
            "openssl.cnf",
            "-extensions",
            section,
            "-out",
            &out,
        ]);
    }

    /// The response to a request, with more arguments.
    pub(crate) fn reply(&self, request: &Path, more: &[&str]) -> PathBuf {
        let out = self.path("response.tsr");
        let args = ["ts", "-reply", "-config", "openssl.cnf", "-section", "tsa", "-signer", "tsa.pem"];
        let files = ["-inkey", "tsa.key", "-out", "response.tsr", "-queryfile"];
        let request = request.to_str().expect("UTF-8");
        self.openssl(&[&args[..], &files, &[request], more].concat());
        out
    }

    /// What is signed in a token.
    pub(crate) fn content(&self, token: &Path) -> Vec<u8> {
        let token = token.to_str().expect("UTF-8");
        self.openssl(&["cms", "-verify", "-noverify", "-inform", "DER", "-in", token, "-out", "content.der"]);
        fs::read(self.path("content.der")).expect("what openssl wrote")
    }

    /// A token with this content, signed by the certificate and key `name`.
    pub(crate) fn sign(&self, content: &[u8], name: &str, more: &[&str]) -> Vec<u8> {
        self.put("content.der", content);
        let [key, certificate] = ["key", "pem"].map(|end| format!("{name}.{end}"));
        let args =
            ["cms", "-sign", "-binary", "-nodetach", "-in", "content.der", "-outform", "DER", "-out", "made.tst"];
        let kind = ["-econtent_type", "1.2.840.113549.1.9.16.1.4", "-nosmimecap", "-signer", &certificate];
        self.openssl(&[&args[..], &kind, &["-inkey", &key], more].concat());
        fs::read(self.path("made.tst")).expect("what openssl wrote")
    }
}

/// Writes a receipt that differs from those of other seeds to `folder/name.json`.
pub(crate) fn receipt(folder: &Path, name: &str, seed: u32) -> PathBuf {
    let mut body = crate::release::receipt::body();
    body.settings["seed"] = seed.into();
    let path = folder.join(format!("{name}.json"));
    Receipt::seal(body, &crate::release::receipt::signer())
        .expect("finite figures")
        .write(&path)
        .expect("a temporary folder is writable");
    path
}
