//! `guard4d farm`: many jobs by one program.

use std::fs;

use guard4d_engine::networks::clip::{ClipModel, ClipSource};
use guard4d_engine::scene::ply;
use serde_json::Value;
use tempfile::TempDir;

use super::embed::contents;
use super::{Run, guard4d, names, put, scratch};
use crate::support::files_below;
use crate::support::fixture::gaussians;
use crate::support::gpu::device;
use crate::support::owner::key_file;
use crate::support::random::Random;

/// No device has this name, so that what opens none is seen.
const NO_DEVICE: [&str; 2] = ["--device", "name:none-of-this-name"];

/// A folder with three models and a manifest.
fn farm(manifest: &str) -> TempDir {
    let folder = scratch();
    for seed in 0..3 {
        let model = ply::encode(&gaussians(30, 1, 7 + seed));
        put(folder.path(), &format!("m{seed}.ply"), &model);
    }
    put(folder.path(), "jobs.csv", manifest.as_bytes());
    folder
}

/// `guard4d farm ACTION jobs.csv …` from another folder than the manifest's.
fn act(folder: &TempDir, action: &str, more: &[&str]) -> Run {
    let manifest = folder.path().join("jobs.csv");
    let mut words: Vec<&dyn AsRef<std::ffi::OsStr>> = vec![&"farm", &action, &manifest];
    words.extend(NO_DEVICE.iter().chain(more).map(|word| word as &dyn AsRef<std::ffi::OsStr>));
    guard4d(&words)
}

fn json(run: &Run) -> Value {
    serde_json::from_str(&run.stdout).expect("JSON on stdout")
}

#[test]
fn rows_are_done_once_and_give_what_commands_give() {
    let folder = farm("id,job,input,output,shot\na,convert,m0.ply,out/a.glb,7\nb,convert,m1.ply,out/b.glb,8\n");
    let plan = act(&folder, "plan", &["--json", "--shards", "2"]);
    plan.done();
    let plan = json(&plan);
    assert_eq!((&plan["rows"], &plan["notes"]), (&2.into(), &vec!["shot"].into()));
    assert_eq!((&plan["jobs"]["convert"]["left"], &plan["jobs"]["convert"]["seconds"]), (&2.into(), &Value::Null));
    assert_eq!(names(folder.path()), ["jobs.csv", "m0.ply", "m1.ply", "m2.ply"], "a plan writes nothing");
    let run = act(&folder, "run", &["--json"]);
    run.done();
    assert_eq!((&json(&run)["done"], &json(&run)["failed"]), (&2.into(), &Value::Object(Default::default())));
    let (alone, model) = (folder.path().join("alone.glb"), folder.path().join("m0.ply"));
    guard4d(&[&"convert", &model, &alone]).done();
    assert_eq!(fs::read(folder.path().join("out/a.glb")).expect("made"), fs::read(alone).expect("made"), "the bytes");
    let again = act(&folder, "run", &["--json"]);
    again.done();
    assert_eq!((&json(&again)["done"], &json(&again)["already"]), (&0.into(), &2.into()));
    let status = act(&folder, "status", &["--json"]);
    status.done();
    assert_eq!((&json(&status)["done"], &json(&status)["rows"]), (&2.into(), &2.into()));
    let records =
        fs::read_dir(folder.path().join("jobs.farm")).expect("made").map(|entry| entry.expect("readable").path());
    let texts = records.filter(|path| path.is_file()).map(|path| fs::read_to_string(path).expect("readable"));
    assert!(texts.collect::<String>().contains(r#""notes":{"shot":"7"}"#), "columns that are no flags are kept");
}

#[test]
fn a_bad_row_fails_alone() {
    let folder = farm(
        "id,job,input,output\na,convert,m0.ply,a.glb\nnone,convert,none.ply,b.glb\n\
         text,convert,jobs.csv,c.glb\nd,convert,m2.ply,d.glb\n",
    );
    let run = act(&folder, "run", &["--json"]);
    assert_eq!(run.code, 3, "{}", run.stderr);
    let printed = json(&run);
    assert_eq!((&printed["done"], printed["failed"].as_object().map(serde_json::Map::len)), (&2.into(), Some(2)));
    assert!(printed["failed"]["none"].as_str().expect("a cause").contains("none.ply: not found"), "{printed}");
    let status = act(&folder, "status", &["--json"]);
    assert_eq!(status.code, 3, "{}", status.stderr);
    let failures = &json(&status)["failures"];
    assert_eq!((&failures["66"][0]["id"], &failures["65"][0]["id"]), (&"none".into(), &"text".into()));
    // Mended, and tried again.
    fs::copy(folder.path().join("m1.ply"), folder.path().join("none.ply")).expect("writable");
    let retried = act(&folder, "run", &["--retry-failed", "--json"]);
    assert_eq!((retried.code, &json(&retried)["done"]), (3, &1.into()), "{}", retried.stderr);
    assert_eq!(act(&folder, "run", &["--fail-fast", "--ids", "a,d"]).code, 0, "the others are done");
}

#[test]
fn mistakes_are_found_before_the_work() {
    let refused = |manifest: &str, words: &[&str]| {
        let folder = farm(manifest);
        for action in ["plan", "run"] {
            act(&folder, action, &[]).refused(65, words);
        }
        assert!(!folder.path().join("jobs.farm").exists(), "nothing was begun");
    };
    refused("id,job,input,output\na,melt,m0.ply,a\n", &["line 2: job", "`melt`", "keygen, embed"]);
    refused("id,job,input,output\na,convert,,a.glb\n", &["line 2: input", "nothing"]);
    refused("id,job,input,output,time\na,convert,m0.ply,a.glb,noon\n", &["line 2", "noon", "guard4d convert"]);
    refused("id,job,input,output,lossy\na,convert,m0.ply,a.spz,maybe\n", &["line 2: lossy", "true or false"]);
    refused("id,job,input,output,overwrite\na,convert,m0.ply,a.glb,true\n", &["line 2: overwrite", "the farm sets"]);
    refused("id,job,input,output,device\na,convert,m0.ply,a.glb,cpu\n", &["line 2: device", "the farm sets"]);
    let folder = farm("id,job,input,output\na,convert,m0.ply,a.glb\n");
    act(&folder, "run", &["--shard", "3/2"]).refused(2, &["shard", "I from 1 to N"]);
    act(&folder, "run", &["--shard", "auto"]).refused(2, &["auto", "Slurm"]);
    act(&folder, "run", &["--rows", "0-1"]).refused(2, &["rows", "below 1"]);
    act(&folder, "run", &["--ids", "z"]).refused(2, &["ids", "`z`"]);
    guard4d(&[&"farm", &"run", &folder.path().join("none.csv")]).refused(66, &["none.csv", "a manifest"]);
    guard4d(&[&"farm"]).refused(2, &["init", "plan", "run", "status"]);
}

#[test]
fn shards_do_all_rows_between_them_and_switches_are_columns() {
    let folder = farm(
        "id,job,input,output,lossy,moments\na,convert,m0.ply,a.spz,true,\n\
         b,convert,m1.ply,b,false,2\nc,convert,m2.ply,c.glb,,\n",
    );
    for (shard, done) in [("1/2", 2), ("2/2", 1)] {
        let run = act(&folder, "run", &["--shard", shard, "--json"]);
        run.done();
        assert_eq!(json(&run)["done"], done, "shard {shard}");
    }
    assert_eq!(names(&folder.path().join("b")), ["00000.ply", "00001.ply"]);
    assert!(["a.spz", "c.glb"].iter().all(|name| folder.path().join(name).exists()), "all are made");
}

#[test]
fn a_manifest_of_a_folder_can_be_run_as_it_is() {
    let folder = farm("");
    fs::remove_file(folder.path().join("jobs.csv")).expect("there");
    put(folder.path(), "notes.txt", b"no model");
    let init = guard4d(&[&"farm", &"init", &folder.path()]);
    init.done();
    guard4d(&[&"farm", &"init", &folder.path()]).refused(73, &["farm.csv", "exists"]);
    let path = folder.path().join("farm.csv");
    let text = fs::read_to_string(&path).expect("made");
    assert!(text.contains("m0.ply,embed,m0.ply,marked/m0.ply,"), "{text}");
    assert!(!text.contains("notes.txt"), "{text}");
    let plan = guard4d(&[&"farm", &"plan", &path, &"--json"]);
    plan.done();
    let left = |job: &str| json(&plan)["jobs"][job]["left"].clone();
    assert_eq!((left("keygen"), left("embed")), (1.into(), 3.into()));
}

#[test]
fn files_that_are_named_elsewhere_are_looked_up_on_the_node() {
    let folder = farm("id,job,input,output,key,config\na,embed,m0.ply,a,owner.key,env:GUARD4D_TEST_CONFIG\n");
    let config = put(folder.path(), "secret-place.toml", b"stepps = 1\n");
    let manifest = folder.path().join("jobs.csv");
    let mut command = super::command(&[&"farm", &"run", &manifest, &NO_DEVICE[0], &NO_DEVICE[1], &"--json"]);
    let run = Run::of(command.env("GUARD4D_TEST_CONFIG", &config).output().expect("the program starts"));
    assert_eq!(run.code, 3, "{}", run.stderr);
    let cause = json(&run)["failed"]["a"].to_string();
    assert!(cause.contains("secret-place.toml") && cause.contains("stepps"), "the file was read: {cause}");
    act(&folder, "plan", &[]).done();
}

#[test]
fn embeddings_of_one_process_stop_go_on_and_give_the_bytes_of_commands() {
    let Some(gpu) = device() else { return };
    let clip = ClipModel::load(&gpu, &ClipSource::Mini).expect("the embedded checkpoint is complete");
    let rows = "id,job,input,output,key,extractor,train-clips,probes,size,orbit,frames,steps\n\
                one,embed,m0.ply,one,owner.key,joint,2,16,32x32,1,2,8\n\
                two,embed,m1.ply,two,owner.key,joint,2,16,32x32,1,2,8\n";
    let folder = farm(rows);
    put(folder.path(), "owner.key", &key_file(&clip).to_bytes().expect("serialises"));
    let manifest = folder.path().join("jobs.csv");
    let before = names(folder.path());
    let tried = guard4d(&[&"farm", &"plan", &manifest, &"--try", &"--json"]);
    tried.done();
    let embed = &json(&tried)["jobs"]["embed"];
    assert!(embed["seconds"].as_f64().is_some_and(|seconds| seconds > 0.0), "{embed}");
    assert!(embed["device_bytes"].as_u64().is_some_and(|bytes| bytes > 0), "{embed}");
    assert!(["one", "two"].contains(&embed["tried"].as_str().unwrap_or_default()), "{embed}");
    assert_eq!(names(folder.path()), before, "a plan writes nothing");
    let run = || super::command(&[&"farm", &"run", &manifest, &"--json"]);
    let stopped = super::interrupted(run(), "XCPU", || super::is_begun(folder.path(), "one"));
    assert_eq!((stopped.code, &json(&stopped)["left"]), (75, &2.into()), "{}", stopped.stderr);
    assert!(!names(folder.path()).iter().any(|name| name.contains("partial")), "{:?}", names(folder.path()));
    let status = guard4d(&[&"farm", &"status", &manifest, &"--json"]);
    assert_eq!(json(&status)["interrupted"], 1, "{}", status.stdout);
    let went_on = Run::of(run().output().expect("the program starts"));
    // Marks of eight steps miss the gate.
    assert_eq!(went_on.code, 3, "{}", went_on.stderr);
    for (name, model) in [("one", "m0.ply"), ("two", "m1.ply")] {
        assert_eq!(json(&went_on)["failed"][name], "the quality gate was missed");
        let [out, model, key] = ["alone", model, "owner.key"].map(|name| folder.path().join(name));
        let flags = "--extractor joint --train-clips 2 --probes 16 --size 32x32 --orbit 1 --frames 2 --steps 8 -q -w";
        let mut words: Vec<&dyn AsRef<std::ffi::OsStr>> = vec![&"embed", &model, &"--key", &key, &"--out", &out];
        let flags: Vec<&str> = flags.split(' ').collect();
        words.extend(flags.iter().map(|flag| flag as &dyn AsRef<std::ffi::OsStr>));
        assert_eq!(guard4d(&words).code, 1, "the gate is missed here, too");
        assert!(contents(&out) == contents(&folder.path().join(name)), "the bytes of {name}");
    }
}

/// A folder with a program of this name that does what the shell script says.
fn stub(name: &str, script: &str) -> TempDir {
    use std::os::unix::fs::PermissionsExt as _;
    let folder = scratch();
    let path = put(folder.path(), name, format!("#!/bin/sh\n{script}\n").as_bytes());
    fs::set_permissions(path, fs::Permissions::from_mode(0o755)).expect("writable");
    folder
}

#[test]
fn schedulers_are_given_what_they_run() {
    let folder = farm("id,job,input,output\na,convert,m0.ply,a.glb\nb,convert,m1.ply,b.glb\n");
    let manifest = folder.path().join("jobs.csv");
    let dry = guard4d(&[&"farm", &"submit", &manifest, &"--engine", &"slurm", &"--dry-run"]);
    dry.done();
    assert!(dry.stdout.contains("#SBATCH --array=1-2\n"), "no more tasks than rows: {}", dry.stdout);
    assert!(!folder.path().join("jobs.farm").exists(), "nothing was written");

    // A Slurm that runs every task of the array at once.
    let sbatch = stub(
        "sbatch",
        "for i in 1 2; do SLURM_ARRAY_TASK_ID=$i SLURM_ARRAY_TASK_MIN=1 SLURM_ARRAY_TASK_MAX=2 \
         sh -c \"$(sed 's/^srun --kill-on-bad-exit=1//' $2)\" >&2 || exit; done; echo 42",
    );
    let path = format!("{}:{}", sbatch.path().display(), std::env::var("PATH").expect("a shell's"));
    let submit = |engine: &str, path: &str| {
        let mut command = super::command(&[&"farm", &"submit", &manifest, &"--engine", &engine]);
        Run::of(command.env("PATH", path).output().expect("the program starts"))
    };
    let submitted = submit("slurm", &path);
    submitted.done();
    assert_eq!(submitted.stdout, "42\n", "the job's number");
    assert_eq!(json(&act(&folder, "status", &["--json"]))["done"], 2);
    submit("slurm", "/nowhere").refused(69, &["sbatch"]);
    let busy = stub("sbatch", "echo 'Batch job submission failed: Invalid job array' >&2; exit 1");
    submit("slurm", &format!("{}:/bin:/usr/bin", busy.path().display())).refused(69, &["Invalid job array"]);
    submit("openjd", &path).done();
    let template = fs::read(folder.path().join("jobs.farm/openjd.template.json")).expect("made");
    let template: Value = serde_json::from_slice(&template).expect("JSON");
    assert_eq!(template["specificationVersion"], "jobtemplate-2023-09");
}

#[test]
fn schedulers_that_take_files_find_them_beside_the_records() {
    let folder = farm("id,job,input,output\na,convert,m0.ply,a.glb\nb,convert,m1.ply,b.glb\n");
    let manifest = folder.path().join("jobs.csv");
    let submit = |engine: &str, flag: &str, user: &str| {
        let mut command = super::command(&[&"farm", &"submit", &manifest, &"--engine", &engine, &flag]);
        command.env("SHOW", "show7").env("SHOT", "s0340").env("USER", user);
        Run::of(command.output().expect("the program starts"))
    };
    for (engine, files, next) in [
        ("opencue", &["opencue.xml"][..], "opencue.api.launchSpec"),
        ("flamenco", &["guard4d-farm.js"][..], "flamenco-manager"),
        ("deadline", &["deadline.job", "deadline.plugin"][..], "deadlinecommand"),
    ] {
        let paths: Vec<_> = files.iter().map(|name| folder.path().join("jobs.farm").join(name)).collect();
        let dry = submit(engine, "--dry-run", "ann");
        dry.done();
        assert!(!paths.iter().any(|path| path.exists()), "nothing was written for {engine}");
        let submitted = submit(engine, "--shards=8", "ann");
        submitted.done();
        assert!(submitted.stderr.contains(next), "{}", submitted.stderr);
        let texts: Vec<_> = paths.iter().map(|path| fs::read_to_string(path).expect("written")).collect();
        assert_eq!(dry.stdout, texts.join("\n"), "what {engine} is given");
        let name = manifest.to_str().expect("UTF-8");
        assert!(texts.iter().any(|text| text.contains(name)), "the manifest is named: {texts:?}");
    }
    submit("opencue", "--dry-run", "root").refused(2, &["USER", "root"]);
}

#[test]
fn progress_is_told_as_openjd_reads_it() {
    let folder = farm("id,job,input,output\na,convert,m0.ply,a.glb\nb,convert,m1.ply,b.glb\n");
    let manifest = folder.path().join("jobs.csv");
    let mut command = super::command(&[&"farm", &"run", &manifest, &NO_DEVICE[0], &NO_DEVICE[1]]);
    let run = Run::of(command.env("OPENJD_SESSION_WORKING_DIR", "/tmp").output().expect("the program starts"));
    run.done();
    let said: Vec<&str> = run.stdout.lines().filter(|line| line.starts_with("openjd_")).collect();
    let expected =
        ["openjd_progress: 50", "openjd_status: rows 1/2", "openjd_progress: 100", "openjd_status: rows 2/2"];
    assert_eq!(said, expected);
    // A chunk that is tried again tells of what was done before, too.
    let again = Run::of(command.output().expect("the program starts"));
    let said: Vec<&str> = again.stdout.lines().filter(|line| line.starts_with("openjd_")).collect();
    assert_eq!(said, expected, "all rows are passed over");
}

#[test]
fn a_report_tells_failures_figures_and_pictures_in_one_page() {
    let folder = farm("id,job,input,output\na,convert,m0.ply,a.glb\n<b>,convert,m1.ply,b.glb\n");
    act(&folder, "report", &[]).refused(65, &["line 3: id"]);
    put(folder.path(), "jobs.csv", b"id,job,input,output\na,convert,m0.ply,a.glb\nb,convert,none<i>.ply,b.glb\n");
    assert_eq!(act(&folder, "run", &[]).code, 3);
    let [page, csv] = ["report.html", "rows.csv"].map(|name| folder.path().join(name));
    let [page_path, csv_path] = [&page, &csv].map(|path| path.display().to_string());
    let report = act(&folder, "report", &["--json", "--out", &page_path, "--csv", &csv_path]);
    assert_eq!(report.code, 3, "a row has failed: {}", report.stderr);
    let told = json(&report);
    assert_eq!((&told["status"]["done"], &told["jobs"][0]["job"]), (&1.into(), &"convert".into()));
    let html = fs::read_to_string(&page).expect("made");
    for words in ["SOME FAILED", "1 of 2 rows are done", "none&lt;i&gt;.ply", ">66<", "2 attempts by 1 workers"] {
        assert!(html.contains(words), "{words}: {html}");
    }
    assert!(!html.contains("none<i>") && html.contains("script-src 'none'"), "nothing is run or fetched: {html}");
    let csv = fs::read_to_string(&csv).expect("made");
    assert!(csv.contains("a,convert,done,1,0,") && csv.contains("b,convert,failed,1,66,"), "{csv}");
    assert!(folder.path().join("jobs.farm/ledger.sqlite").is_file(), "all records in one database");
    act(&folder, "report", &["--out", &page_path]).refused(73, &["report.html", "exists"]);
    // The run does not mistake it for a journal.
    assert_eq!(act(&folder, "run", &[]).code, 3);
}

#[test]
fn monitors_and_logs_are_told_in_their_own_ways() {
    let folder = farm("id,job,input,output\na,convert,m0.ply,a.glb\nb,convert,none.ply,b.glb\n");
    let run = act(&folder, "run", &["--progress", "json"]);
    assert_eq!(run.code, 3, "{}", run.stderr);
    let lines: Vec<Value> = run.stderr.lines().filter_map(|line| serde_json::from_str(line).ok()).collect();
    let events: Vec<[&Value; 3]> =
        lines.iter().map(|line| [&line["event"], &line["row"], &line["exit_code"]]).collect();
    let [begins, ends, none] = ["begins".into(), "ends".into(), Value::Null];
    let [a, b, zero, missing] = ["a".into(), "b".into(), 0.into(), 66.into()];
    let expected: [[&Value; 3]; 4] =
        [[&begins, &a, &none], [&begins, &b, &none], [&ends, &a, &zero], [&ends, &b, &missing]];
    let mut sorted = events.clone();
    sorted.sort_by_key(|event| (event[0].to_string(), event[1].to_string()));
    assert_eq!(sorted, expected, "{}", run.stderr);
    assert_eq!(lines.last().map(|line| [&line["done"], &line["of"]]), Some([&2.into(), &2.into()]));

    let metrics = folder.path().join("guard4d.prom");
    assert_eq!(act(&folder, "status", &["--metrics", &metrics.display().to_string()]).code, 3);
    let text = fs::read_to_string(&metrics).expect("made");
    assert!(text.contains("guard4d_farm_rows{manifest=\"jobs.csv\",state=\"done\"} 1\n"), "{text}");

    // A Slurm whose jobs have comments.
    let said = folder.path().join("said");
    let scontrol = stub("scontrol", &format!("echo \"$@\" >> {}", said.display()));
    let manifest = folder.path().join("jobs.csv");
    let mut command = super::command(&[&"farm", &"run", &manifest, &NO_DEVICE[0], &NO_DEVICE[1], &"--retry-failed"]);
    let path = format!("{}:{}", scontrol.path().display(), std::env::var("PATH").expect("a shell's"));
    command.env("PATH", path).env("SLURM_JOB_ID", "42");
    assert_eq!(Run::of(command.output().expect("the program starts")).code, 3);
    let comment = || fs::read_to_string(&said).unwrap_or_default();
    // The controller answers when it likes.
    for _ in 0..100 {
        if comment().is_empty() {
            std::thread::sleep(std::time::Duration::from_millis(20));
        }
    }
    assert!(comment().starts_with("update jobid=42 comment=rows 1/2\n"), "{}", comment());
}

#[test]
fn runs_that_are_killed_lose_nothing_and_leave_nothing() {
    const ROWS: usize = 16;
    // Folders of files, whose making takes long enough to be caught at.
    let rows: String = (0..ROWS).map(|n| format!("r{n},convert,m{}.ply,out/{n},40\n", n % 3)).collect();
    let rows = format!("id,job,input,output,moments\n{rows}");
    let (quiet, killed) = (farm(&rows), farm(&rows));
    act(&quiet, "run", &[]).done();
    let manifest = killed.path().join("jobs.csv");
    let mut random = Random(26);
    let mut kills = 0;
    for _ in 0..20 {
        let mut command = super::command(&[&"farm", &"run", &manifest, &NO_DEVICE[0], &NO_DEVICE[1]]);
        let mut child = command.spawn().expect("the program starts");
        std::thread::sleep(std::time::Duration::from_micros((random.uniform(2.0, 120.0) * 1e3) as u64));
        kills += usize::from(child.try_wait().expect("a child").is_none());
        child.kill().expect("it can be killed");
        child.wait().expect("a child");
    }
    assert!(kills > 0, "some run was caught at work");
    let last = act(&killed, "run", &["--json"]);
    last.done();
    assert_eq!(json(&last)["elsewhere"], 0, "dead workers hold nothing");
    let files = |folder: &TempDir| -> Vec<(String, Vec<u8>)> {
        let root = folder.path().join("out");
        let read = |path: std::path::PathBuf| {
            let bytes = fs::read(root.join(&path)).expect("readable");
            (path.display().to_string(), bytes)
        };
        files_below(&root).into_iter().map(read).collect()
    };
    assert!(files(&quiet) == files(&killed), "the bytes of a quiet run, and no other file");
    assert_eq!(names(&killed.path().join("jobs.farm/claims")), Vec::<String>::new(), "no claim is left");
    let lines =
        fs::read_dir(killed.path().join("jobs.farm")).expect("made").map(|entry| entry.expect("readable").path());
    let texts: String =
        lines.filter(|path| path.is_file()).map(|path| fs::read_to_string(path).expect("text")).collect();
    // Killed between output and record, a row is done again; it is never recorded as done twice.
    assert_eq!(texts.matches(r#""state":"done""#).count(), ROWS, "each row is done once in the records");
}
