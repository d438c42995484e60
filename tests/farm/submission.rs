//! Submissions: what schedulers are given names program and manifest as a shell takes them.

use std::path::Path;

use guard4d_engine::farm::submission::Submission;

fn submission(rows: usize, shards: usize) -> Submission<'static> {
    let [program, manifest, logs] = ["/opt/guard4d", "/shows/it's/jobs.csv", "/shows/it's/jobs.farm"].map(Path::new);
    Submission { program, manifest, logs, rows, shards }
}

#[test]
fn slurm_gets_an_array_that_can_be_requeued() {
    let script = submission(100, 16).slurm().expect("a script");
    for line in ["#SBATCH --array=1-16", "#SBATCH --requeue", "#SBATCH --signal=TERM@60", "#SBATCH --open-mode=append"]
    {
        assert!(script.lines().any(|found| found == line), "{line} in\n{script}");
    }
    let run = script.lines().find(|line| line.starts_with("srun")).expect("a step of its own");
    let words = shlex::split(run).expect("a shell reads it");
    assert_eq!(words[2..], ["/opt/guard4d", "farm", "run", "/shows/it's/jobs.csv", "--shard", "auto"]);
    assert!(script.ends_with("exit $?\n"), "the step's exit code is the task's");
    let error = submission(5000, 1001).slurm().expect_err("too many").to_string();
    assert!(error.contains("1001") && error.contains("1000"), "{error}");
}

#[test]
fn openjd_gets_a_task_for_each_row_in_chunks() {
    let template = submission(100, 16).openjd().expect("a template");
    let rows = &template["steps"][0]["parameterSpace"]["taskParameterDefinitions"][0];
    assert_eq!((&rows["range"], &rows["chunks"]["defaultTaskCount"]), (&"0-99".into(), &7.into()));
    let script = template["steps"][0]["script"]["embeddedFiles"][0]["data"].as_str().expect("a script");
    let command = script.strip_prefix("#!/bin/bash\nexec ").expect("the signal reaches the program itself");
    let words = shlex::split(command).expect("a shell reads it");
    assert_eq!(words, ["/opt/guard4d", "farm", "run", "/shows/it's/jobs.csv", "--rows", "{{Task.Param.Row}}"]);
}
