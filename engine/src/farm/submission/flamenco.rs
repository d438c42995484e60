//! A job type for Flamenco 3.

use serde_json::{Value, json};

use super::task::{Submission, printable};
use crate::error::EngineError;

/// How the script is used.
const HEAD: &str = r#"// guard4d: the rows of a manifest, dealt to tasks.
//
// Lay this file into the folder `scripts` beside flamenco-manager, which then knows the job type guard4d-farm. A job
// that leaves settings out gets those of the manifest that the file was written for:
//   curl -H "Content-Type: application/json" http://MANAGER:8080/api/v3/jobs \
//     -d '{"name": "farm", "type": "guard4d-farm", "priority": 50, "submitter_platform": "linux", "settings": {}}'

"#;

/// How a job becomes tasks.
const COMPILE: &str = r#"
// Flamenco looks at no exit code, and where one worker alone can do a task its first failure ends the whole job. So 75,
// which asks to go on later, goes on at once; every other failure is one.
const GO_ON = 'until "$@"; do [ $? = 75 ] || exit 1; done';

function compileJob(job) {
    // Only Flamenco's own add-on fills in what a job leaves out.
    const [program, manifest, shards] = JOB_TYPE.settings.map(({ key, default: ours }) => job.settings[key] || ours);
    for (let shard = 1; shard <= shards; shard++) {
        const task = author.Task(`shard-${shard}`, "misc");
        task.addCommand(author.Command("exec", {
            exe: "/bin/sh",
            args: ["-c", GO_ON, "guard4d", program, "farm", "run", manifest, "--shard", `${shard}/${shards}`],
        }));
        job.addTask(task);
    }
}
"#;

impl Submission<'_> {
    /// A job type of Flamenco, as JavaScript: a task for each shard.
    ///
    /// # Errors
    /// [`EngineError::Usage`] for paths with control characters, which Flamenco's page and log could not show.
    pub fn flamenco(&self) -> Result<String, EngineError> {
        // JSON is JavaScript.
        let job_type = json!({
            "label": "guard4d farm",
            "settings": [
                setting("program", "string", printable(self.program)?.into(), "guard4d, as workers find it"),
                setting("manifest", "string", printable(self.manifest)?.into(), "Manifest, as workers find it"),
                setting("shards", "int32", self.shards.into(), "Tasks that the rows are dealt to"),
            ],
        });
        Ok(format!("{HEAD}const JOB_TYPE = {job_type:#};\n{COMPILE}"))
    }
}

/// A setting of the job type, by its name, type and value.
fn setting(key: &str, kind: &str, value: Value, description: &str) -> Value {
    json!({ "key": key, "type": kind, "default": value, "description": description })
}
