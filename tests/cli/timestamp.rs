//! `guard4d timestamp`, with openssl as the authority.

use serde_json::Value;

use super::{guard4d, names, put, scratch};
use crate::support::authority::{Authority, P256, has_openssl, receipt};

#[test]
fn a_receipt_is_dated_in_three_steps() {
    if !has_openssl() {
        return;
    }
    let (folder, authority) = (scratch(), Authority::new(P256, "sha256"));
    let file = receipt(folder.path(), "receipt", 1);
    let (request, ca) = (folder.path().join("request.tsq"), authority.path("ca.pem"));
    let asked = guard4d(&[&"timestamp", &"request", &file, &"--out", &request, &"--json"]);
    asked.done();
    let asked: Value = serde_json::from_str(&asked.stdout).expect("JSON on stdout");
    assert_eq!(asked["sha256"].as_str().map(str::len), Some(64), "{asked}");
    guard4d(&[&"timestamp", &"request", &file, &"--out", &request]).refused(73, &["request.tsq", "it exists"]);
    let response = authority.reply(&request, &[]);
    let attach = guard4d(&[&"timestamp", &"attach", &file, &"--response", &response, &"--request", &request]);
    attach.done();
    assert!(attach.stdout.contains("date claimed") && attach.stderr.contains("receipt.tst"), "{}", attach.stdout);
    guard4d(&[&"timestamp", &"attach", &file, &"--response", &response]).refused(73, &["receipt.tst", "it exists"]);
    guard4d(&[&"timestamp", &"attach", &file, &"--response", &response, &"-w"]).done();

    let claimed = guard4d(&[&"timestamp", &"check", &file]);
    assert_eq!(claimed.code, 4, "nobody was trusted: {}", claimed.stderr);
    assert!(claimed.stdout.contains("no: anyone can have made this token"), "{}", claimed.stdout);
    let checked = guard4d(&[&"timestamp", &"check", &file, &"--ca", &ca]);
    checked.done();
    assert!(checked.stdout.contains("The tsa") && checked.stdout.contains("1.2.3.4.1"), "{}", checked.stdout);
    let json = guard4d(&[&"timestamp", &"check", &file, &"--ca", &ca, &"--json"]);
    let json: Value = serde_json::from_str(&json.stdout).expect("JSON on stdout");
    assert_eq!(
        (&json["trust"], &json["receipts"], &json["of"]),
        (&"checked".into(), &1.into(), &asked["of"]),
        "{json}"
    );
    assert_eq!(names(folder.path()), ["receipt.json", "receipt.tst", "request.tsq"], "nothing else");
}

#[test]
fn dates_of_others_and_by_others_are_refused() {
    if !has_openssl() {
        return;
    }
    // Both before the token, so that its date is within both certificates.
    let [authority, stranger] = [(); 2].map(|()| Authority::new(P256, "sha256"));
    let folder = scratch();
    let (one, two) = (receipt(folder.path(), "one", 1), receipt(folder.path(), "two", 2));
    let request = folder.path().join("request.tsq");
    guard4d(&[&"timestamp", &"request", &one, &"--out", &request]).done();
    let response = authority.reply(&request, &[]);
    guard4d(&[&"timestamp", &"attach", &two, &"--response", &response])
        .refused(65, &["response.tsr: TSTInfo.messageImprint", "expected"]);
    guard4d(&[&"timestamp", &"attach", &one, &"--response", &response]).done();
    let token = folder.path().join("one.tst");
    guard4d(&[&"timestamp", &"check", &two]).refused(66, &["two.tst: not found"]);
    guard4d(&[&"timestamp", &"check", &two, &"--timestamp", &token]).refused(65, &["one.tst: TSTInfo.messageImprint"]);
    guard4d(&[&"timestamp", &"check", &one, &"--ca", &stranger.path("ca.pem")]).refused(65, &["certificate.signature"]);
    let text = put(folder.path(), "notes.txt", b"no receipt");
    guard4d(&[&"timestamp", &"request", &text, &"--out", &folder.path().join("x")]).refused(65, &["notes.txt: schema"]);
    guard4d(&[&"timestamp"]).refused(2, &["request", "attach", "check"]);
}
