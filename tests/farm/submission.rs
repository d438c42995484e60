//! Submissions: what schedulers are given names program and manifest as they, and the shells between, take them.

use std::path::Path;

use guard4d_engine::farm::submission::{CueNames, Submission};
use roxmltree::{Document, ParsingOptions};
use serde_json::{Value, json};

fn submission(rows: usize, shards: usize) -> Submission<'static> {
    let [program, manifest, logs] = ["/opt/guard4d", "/shows/it's/jobs.csv", "/shows/it's/jobs.farm"].map(Path::new);
    Submission { program, manifest, logs, rows, shards }
}

/// A program and a manifest with everything in their paths that means something to somebody.
fn awkward() -> Submission<'static> {
    let [program, manifest] = ["/opt/guard 4d/guard4d", r#"/shows/it's "A & B" <1>/$HOME\jobs.csv"#].map(Path::new);
    Submission { program, manifest, ..submission(100, 3) }
}

fn names() -> CueNames {
    let [show, shot, user] = ["show7", "s0340", "ann"].map(str::to_owned);
    CueNames { show, shot, user }
}

/// Everything in an XML file but space and comments, on lines: tags with attributes, and texts.
fn outline(xml: &str) -> Vec<String> {
    let options = ParsingOptions { allow_dtd: true, ..ParsingOptions::default() };
    let document = Document::parse_with_options(xml, options).expect("XML");
    let elements = document.descendants().filter(|node| node.is_element());
    let told = elements.map(|element| {
        let attributes = element.attributes().map(|a| format!(" {}={}", a.name(), a.value())).collect::<String>();
        let text = element.text().map(str::trim).filter(|text| !text.is_empty());
        format!("{}{attributes} {}", element.tag_name().name(), text.unwrap_or_default()).trim_end().to_owned()
    });
    told.collect()
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

#[test]
fn opencue_gets_a_layer_with_a_frame_for_each_shard() {
    let xml = submission(100, 16).opencue(&names()).expect("a specification");
    // What pyoutline 1.37 makes of the same, in its order; it adds facility, address and number of the user.
    let expected = "spec|show show7|shot s0340|user ann|job name=guard4d_farm|paused False|priority 1|maxretries 2\
        |autoeat False|env|layers|layer name=shards type=Render\
        |cmd /opt/guard4d farm run MANIFEST --shard #IFRAME#/16\
        |range 1-16|chunk 1|env|services|service default|outputs|depends";
    let manifest = shlex::try_quote("/shows/it's/jobs.csv").expect("no NUL");
    assert_eq!(outline(&xml).join("|"), expected.replace("MANIFEST", &manifest));
    let start = "<?xml version=\"1.0\"?>\n<!DOCTYPE spec PUBLIC \"SPI Cue  Specification Language\" \
                 \"http://localhost:8080/spcue/dtd/cjsl-1.15.dtd\">\n";
    assert!(xml.starts_with(start), "{xml}");
    assert!(xml.contains("dispatcher.layer_delay.rules=75:"), "what a site sets for exit code 75");
    let xml = awkward().opencue(&CueNames { user: "a&<n>".to_owned(), ..names() }).expect("a specification");
    let told = outline(&xml);
    assert!(told.iter().any(|line| line == "user a&<n>"), "{told:?}");
    let command = told.iter().find_map(|line| line.strip_prefix("cmd ")).expect("a command");
    let words = shlex::split(&command.replace("#IFRAME#", "2")).expect("a shell reads it");
    let manifest = awkward().manifest.to_str().expect("UTF-8");
    assert_eq!(words, ["/opt/guard 4d/guard4d", "farm", "run", manifest, "--shard", "2/3"]);
}

#[test]
fn opencue_is_given_no_names_that_it_refuses() {
    let refused = |names: CueNames, words: [&str; 2]| {
        let error = submission(1, 1).opencue(&names).expect_err("refused").to_string();
        assert!(words.iter().all(|word| error.contains(word)), "{words:?} in {error}");
    };
    refused(CueNames { show: "a7".to_owned(), ..names() }, ["SHOW", "`a7`"]);
    refused(CueNames { shot: "s/0340".to_owned(), ..names() }, ["SHOT", "`s/0340`"]);
    refused(CueNames { user: String::new(), ..names() }, ["USER", "``"]);
    refused(CueNames { user: "root".to_owned(), ..names() }, ["USER", "root"]);
    let error = submission(200_000, 100_001).opencue(&names()).expect_err("too many").to_string();
    assert!(error.contains("100001") && error.contains("100000"), "{error}");
}

/// Whether the brackets of a script close in order, those in texts and comments aside.
fn is_balanced(script: &str) -> bool {
    let (mut open, mut quote): (Vec<char>, Option<char>) = (Vec::new(), None);
    let mut letters = script.chars().peekable();
    while let Some(c) = letters.next() {
        match (quote, c) {
            (Some(_), '\\') => {
                letters.next();
            }
            (Some(q), _) if q == c => quote = None,
            (Some(_), _) => {}
            (None, '/') if letters.peek() == Some(&'/') => while letters.next_if(|c| *c != '\n').is_some() {},
            (None, '"' | '\'' | '`') => quote = Some(c),
            (None, '(') => open.push(')'),
            (None, '[') => open.push(']'),
            (None, '{') => open.push('}'),
            (None, ')' | ']' | '}') if open.pop() != Some(c) => return false,
            (None, _) => {}
        }
    }
    open.is_empty() && quote.is_none()
}

#[test]
fn flamenco_gets_a_job_type_with_our_values() {
    let script = awkward().flamenco().expect("a script");
    assert!(is_balanced(&script), "{script}");
    let broken = script.trim_end().strip_suffix('}').expect("the end of a function");
    assert!(!is_balanced(broken), "a bracket that is missing is seen");
    let (_, settings) = script.split_once("const JOB_TYPE = ").expect("the type");
    let (settings, rest) = settings.split_once(";\n").expect("its end");
    let settings: Value = serde_json::from_str(settings).expect("JSON");
    let values: Vec<_> =
        settings["settings"].as_array().expect("a list").iter().map(|s| (&s["key"], &s["default"])).collect();
    let [program, manifest] = [awkward().program, awkward().manifest].map(|path| json!(path.to_str().expect("UTF-8")));
    assert_eq!(values, [(&json!("program"), &program), (&json!("manifest"), &manifest), (&json!("shards"), &json!(3))]);
    for part in [
        "function compileJob(job) {",
        r#"const GO_ON = 'until "$@"; do [ $? = 75 ] || exit 1; done';"#,
        r#"author.Command("exec", {"#,
        r#"args: ["-c", GO_ON, "guard4d", program, "farm", "run", manifest, "--shard", `${shard}/${shards}`],"#,
    ] {
        assert!(rest.contains(part), "{part} in\n{script}");
    }
}

#[test]
fn deadline_gets_a_frame_for_each_shard_and_quotes_of_its_own() {
    let manifest = Path::new("/shows/it's A & B/jobs.csv");
    let files = Submission { manifest, ..awkward() }.deadline().expect("two files");
    let job = "Plugin=CommandLine\nName=guard4d-farm\nComment=/shows/it's A & B/jobs.csv\nFrames=1-3\nChunkSize=1\n";
    assert_eq!(files.job, job);
    let plugin = "Executable=/opt/guard 4d/guard4d\n\
                  Arguments=farm run <QUOTE>/shows/it's A & B/jobs.csv<QUOTE> --shard <STARTFRAME>/3\n\
                  ShellExecute=False\nSingleFramesOnly=True\n";
    assert_eq!(files.plugin, plugin);
    for path in ["/a\"b.csv", "/<QUOTE>.csv", "/\u{201c}b\u{201d}.csv"] {
        let error = Submission { manifest: Path::new(path), ..awkward() }.deadline().expect_err("refused").to_string();
        assert!(error.contains(path) && error.contains("Deadline"), "{error}");
    }
}

#[test]
fn lines_end_where_their_values_end() {
    let broken = Submission { manifest: Path::new("/shows/a\nb.csv"), ..submission(2, 2) };
    let errors = [
        broken.opencue(&names()).expect_err("refused"),
        broken.flamenco().expect_err("refused"),
        broken.deadline().expect_err("refused"),
    ];
    for error in errors {
        assert!(error.to_string().contains("control characters"), "{error}");
    }
}
