//! A job template of OpenJD.

use serde_json::{Value, json};

use super::task::Submission;
use crate::error::EngineError;

/// How long before its end a task that is cancelled is told, seconds.
const NOTICE_S: u32 = 30;

impl Submission<'_> {
    /// A job template of OpenJD (2023-09, with chunks of tasks), as JSON: a task for each row, of which about as many
    /// chunks are made as there are shards.
    ///
    /// # Errors
    /// [`EngineError::Usage`] for paths that no shell can name.
    pub fn openjd(&self) -> Result<Value, EngineError> {
        let run = format!("#!/bin/bash\nexec {}\n", self.command("--rows {{Task.Param.Row}}")?);
        let last = self.rows - 1;
        Ok(json!({
            "specificationVersion": "jobtemplate-2023-09",
            "extensions": ["TASK_CHUNKING"],
            "name": "guard4d-farm",
            "steps": [{
                "name": "Rows",
                "parameterSpace": { "taskParameterDefinitions": [{
                    "name": "Row",
                    "type": "CHUNK[INT]",
                    "range": format!("0-{last}"),
                    "chunks": {
                        "defaultTaskCount": self.rows.div_ceil(self.shards),
                        "rangeConstraint": "NONCONTIGUOUS",
                    },
                }] },
                "script": {
                    "embeddedFiles": [{ "name": "run", "type": "TEXT", "runnable": true, "data": run }],
                    "actions": { "onRun": {
                        "command": "{{Task.File.run}}",
                        "cancelation": {
                            "mode": "NOTIFY_THEN_TERMINATE",
                            "notifyPeriodInSeconds": NOTICE_S,
                        },
                    } },
                },
            }],
        }))
    }
}
