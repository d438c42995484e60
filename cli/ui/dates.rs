//! Dates, for people.

use guard4d_engine::release::dating::standing::{Dated, Standing, UnderRoot};
use guard4d_engine::release::dating::token::{Stamp, Trust};

use super::report::{Row, table};

/// A token that was checked, as a table.
pub(crate) fn dated(dated: &Dated) -> String {
    let Dated { of, receipts, stamp } = dated;
    let mut rows = vec![("date", when(stamp)), ("authority", stamp.authority.clone())];
    rows.push(("authority checked", checked(stamp.trust).to_owned()));
    rows.extend(marks(stamp));
    rows.push(("of", of.to_string()));
    rows.push(("receipts", receipts.to_string()));
    table(&rows)
}

/// What a token says beside date and authority.
pub(crate) fn marks(stamp: &Stamp) -> [Row; 2] {
    [("serial number", stamp.serial.clone()), ("policy", stamp.policy.clone())]
}

/// The date, and how far it may be off.
pub(crate) fn when(stamp: &Stamp) -> String {
    match stamp.accuracy_s {
        Some(seconds) => format!("{}, {seconds} s either way", stamp.date),
        None => stamp.date.clone(),
    }
}

const fn checked(trust: Trust) -> &'static str {
    match trust {
        Trust::Checked => "yes",
        Trust::Claimed => "no: anyone can have made this token; --ca says whom you trust",
    }
}

/// Since when a receipt is there, for the report of a verification.
pub(crate) fn date_in_words(standing: &Standing) -> String {
    let Some(Dated { receipts, stamp, .. }) = &standing.dated else { return "no".to_owned() };
    let among = match receipts {
        1 => String::new(),
        many => format!(", with {} other receipts", many - 1),
    };
    let claimed = match stamp.trust {
        Trust::Checked => "by",
        Trust::Claimed => "claimed, authority not checked:",
    };
    format!("{} {claimed} {}{among}", when(stamp), stamp.authority)
}

/// The root over a receipt.
pub(crate) fn root_in_words(root: &UnderRoot) -> String {
    let UnderRoot { root, receipts } = root;
    format!("{root}; {receipts} receipts are under it, and the claim is counted so many times")
}

/// What a verification leaves open about time.
pub(crate) fn not_shown(standing: &Standing) -> &'static str {
    match standing.dated.as_ref().map(|dated| dated.stamp.trust) {
        None => "that the receipt is older than the clip; a timestamp by someone else can",
        Some(Trust::Claimed) => "that the date is true; --ca says whom you trust",
        Some(Trust::Checked) => "when the clip was made",
    }
}
