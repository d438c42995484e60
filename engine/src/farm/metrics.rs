//! What a monitor reads: the numbers of a status as Prometheus' text.

use std::fmt::Write as _;

use super::status::Status;

impl Status {
    /// Text format 0.0.4 of Prometheus, as node_exporter's textfile collector takes it. `manifest` becomes a label; ids
    /// do not, since they may name customers.
    #[must_use]
    pub fn prometheus(&self, manifest: &str) -> String {
        let manifest = manifest.replace('\\', r"\\").replace('"', "\\\"").replace('\n', r"\n");
        let mut text = String::new();
        let mut head = |name: &str, help: &str, samples: &[(String, f64)]| {
            // Writing to a string does not fail.
            let _ = writeln!(text, "# HELP {name} {help}\n# TYPE {name} gauge");
            for (label, value) in samples {
                let _ = writeln!(text, "{name}{{manifest=\"{manifest}\"{label}}} {value}");
            }
        };
        let states = [
            ("done", self.done),
            ("running", self.running),
            ("interrupted", self.interrupted),
            ("failed", self.failed),
            ("pending", self.pending),
        ];
        let rows = states.map(|(state, rows)| (format!(",state=\"{state}\""), rows as f64));
        head("guard4d_farm_rows", "Rows of the manifest by state.", &rows);
        let failed = |(code, failures): (&u8, &Vec<_>)| (format!(",exit_code=\"{code}\""), failures.len() as f64);
        let failures: Vec<_> = self.failures.iter().map(failed).collect();
        head("guard4d_farm_failed_rows", "Failed rows by exit code.", &failures);
        head("guard4d_farm_work_seconds", "What the done rows took together.", &[(String::new(), self.seconds)]);
        if let Some(left) = self.seconds_left {
            head("guard4d_farm_work_left_seconds", "What the rows left will take together.", &[(String::new(), left)]);
        }
        text
    }
}
