//! What a log of tests says: how many passed, failed and were skipped.

use std::collections::BTreeSet;

use crate::error::{Error, Result};

/// How many tests of a log passed, failed and were skipped.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Counts {
    /// Tests that ran to their end; those that were skipped count as passed in the log, and not here.
    pub(crate) passed: usize,
    /// Tests that failed; `None` where the log ends before its result.
    pub(crate) failed: Option<usize>,
    /// Tests that said why they did not run, or not to their end.
    pub(crate) skipped: usize,
}

impl Counts {
    /// Counts in the log of a test program.
    pub(crate) fn of(log: &str) -> Self {
        let result = log.lines().rfind(|line| line.starts_with("test result:"));
        let passed = result.and_then(|line| number_before(line, " passed")).unwrap_or(0);
        let skipped: BTreeSet<_> = skips(log).filter_map(|skip| skip.split_once(' ')?.0.strip_suffix(':')).collect();
        Self {
            passed: passed.saturating_sub(skipped.len()),
            failed: result.and_then(|line| number_before(line, " failed")),
            skipped: skipped.len(),
        }
    }

    /// Whether any test ran.
    pub(crate) fn any(self) -> bool {
        self.passed + self.skipped + self.failed.unwrap_or(0) > 0
    }

    /// The failed ones as text.
    pub(crate) fn failed(self) -> String {
        self.failed.map_or_else(|| "unknown".to_owned(), |failed| failed.to_string())
    }
}

fn number_before(line: &str, word: &str) -> Option<usize> {
    let before = &line[..line.find(word)?];
    before.rsplit(' ').next()?.parse().ok()
}

/// `NAME: WHY` of every line that tells of a skipped test. What tests print at once may share a line.
fn skips(log: &str) -> impl Iterator<Item = &str> {
    log.lines().filter_map(|line| Some(line.rsplit_once("SKIPPED ")?.1))
}

/// Those of `filters` that no test of a log has in its name. None where the test program was given options, which are
/// not filters.
fn unmatched<'a>(log: &str, filters: &[&'a str]) -> Vec<&'a str> {
    if filters.iter().any(|filter| filter.starts_with('-')) {
        return Vec::new();
    }
    let names: Vec<_> = log.lines().filter_map(|line| line.strip_prefix("test ")?.split(' ').next()).collect();
    filters.iter().copied().filter(|filter| !names.iter().any(|name| name.contains(filter))).collect()
}

/// An error where no test of a log has one of `filters` in its name: what was asked for did not run.
pub(crate) fn all_matched(log: &str, filters: &[&str]) -> Result<()> {
    let missing = unmatched(log, filters);
    if missing.is_empty() {
        return Ok(());
    }
    Err(Error::Missing(format!("no test has in its name: {}", missing.join(", "))))
}

/// What `./x gpu` found, as a page of Markdown.
pub(crate) fn report(log: &str) -> String {
    let counts = Counts::of(log);
    let failed = log.lines().filter_map(|line| line.strip_prefix("test ")?.strip_suffix(" ... FAILED"));
    let mut list: BTreeSet<_> = failed.map(|name| format!("- failed: {name}\n")).collect();
    list.extend(skips(log).map(|skip| format!("- skipped: {skip}\n")));
    let mut page = format!(
        "# Conformance\n\nTests of what the device of summary.md computes, against twins on the host and other \
         implementations' numbers; `./x gpu`.\n\n\
         | passed | failed | skipped |\n| ---: | ---: | ---: |\n| {} | {} | {} |\n",
        counts.passed,
        counts.failed(),
        counts.skipped
    );
    if !list.is_empty() {
        page.push('\n');
        page.extend(list);
    }
    page
}

#[cfg(test)]
mod tests {
    use super::*;

    const LOG: &str = "\
running 5 tests
SKIPPED kernels::b: no subgroups of 8
test kernels::a ... ok
test kernels::b ... SKIPPED kernels::c: no layers: none
test kernels::c ... ok
SKIPPED kernels::b: no subgroups of 8
ok
test render::d ... FAILED
test render::e ... ok

failures:

test result: FAILED. 4 passed; 1 failed; 0 ignored; 0 measured; 40 filtered out; finished in 1.50s
";

    #[test]
    fn a_skipped_test_has_not_passed_and_counts_once() {
        assert_eq!(Counts::of(LOG), Counts { passed: 2, failed: Some(1), skipped: 2 });
    }

    #[test]
    fn a_log_without_result_tells_nothing_of_failures() {
        let broken = Counts::of("running 5 tests\nSKIPPED kernels::b: why\ntest kernels::a ... ok\n");
        assert_eq!(broken, Counts { passed: 0, failed: None, skipped: 1 });
        assert_eq!(broken.failed(), "unknown");
        assert!(!Counts::of("error: could not compile\n").any(), "no test ran");
        let none = "test result: ok. 0 passed; 0 failed; 0 ignored; 0 measured; 40 filtered out\n";
        assert!(!Counts::of(none).any(), "no test has such a name");
        let all_failed = "test result: FAILED. 0 passed; 3 failed; 0 ignored; 0 measured; 40 filtered out\n";
        assert!(Counts::of(all_failed).any(), "failed tests ran");
    }

    #[test]
    fn names_that_no_test_has_are_told() {
        assert_eq!(unmatched(LOG, &["kernels::", "::d", "layers"]), ["layers"], "only names count");
        assert_eq!(unmatched(LOG, &["--exact", "layers"]), [""; 0], "options are not looked into");
        assert!(all_matched(LOG, &["kernels::"]).is_ok(), "they ran");
        let told = all_matched(LOG, &["layers", "kernels::"]).expect_err("no test has the name");
        assert!(told.to_string().ends_with(": layers"), "{told}");
    }

    #[test]
    fn a_report_names_what_failed_and_what_was_skipped() {
        let page = report(LOG);
        let list = "| 2 | 1 | 2 |\n\n- failed: render::d\n- skipped: kernels::b: no subgroups of 8\n\
                    - skipped: kernels::c: no layers: none\n";
        assert!(page.ends_with(list), "{page}");
        let fine = report("test result: ok. 3 passed; 0 failed; 0 ignored; 0 measured; 0 filtered out\n");
        assert!(fine.ends_with("| 3 | 0 | 0 |\n"), "{fine}");
    }
}
