//! Commands and flags as a page of Markdown.

use std::fmt::Write as _;

use clap::builder::StyledStr;
use clap::{Arg, ArgAction, Command};

/// Widest line of the page, in columns. A mark that may not begin the next one can stand behind it.
const WIDEST: usize = 115;

/// Heading of what has none of its own.
const OPTIONS: &str = "Options";

/// The page about `root` and its commands.
pub(crate) fn commands(mut root: Command) -> String {
    root.build();
    let mut page = String::from(
        "# Commands\n\nMade by `guard4d reference cli` of the definitions that parse the command line; do not edit it \
         by hand.\n\n",
    );
    page.push_str(&text(root.get_about(), ""));
    page.push_str("\n| command | what it does |\n| --- | --- |\n");
    let commands: Vec<&Command> = root.get_subcommands().filter(|command| command.get_name() != "help").collect();
    for command in &commands {
        let name = command.get_name();
        let about = command.get_about().map(ToString::to_string).unwrap_or_default();
        let _ = writeln!(page, "| [`{name}`](#guard4d-{name}) | {about} |");
    }
    for command in commands {
        page.push_str(&section(command, ""));
    }
    page.push_str("\n## Flags of every command\n");
    page.push_str(&flags(root.get_arguments().filter(|arg| arg.is_global_set())));
    let exit_codes = root.get_after_help().map(ToString::to_string).unwrap_or_default();
    let (_, table) = exit_codes.split_once('\n').unwrap_or_default();
    let _ = write!(page, "\n## Exit codes\n\n```text\n{table}\n```\n");
    page
}

/// One command, and those below it: what it does, how it is called, what it takes. `above` is the name of the command
/// that it is one of, with a space behind it.
fn section(command: &Command, above: &str) -> String {
    let name = format!("{above}{}", command.get_name());
    let usage = command.clone().render_usage().to_string();
    let usage = usage.trim_start_matches("Usage: ");
    let about = text(command.get_long_about().or_else(|| command.get_about()), "");
    let mut section = format!("\n## guard4d {name}\n\n{about}\n```text\n{usage}\n```\n");
    let arguments: Vec<&Arg> = command.get_positionals().collect();
    if !arguments.is_empty() {
        section.push_str("\n### Arguments\n\n");
        section.extend(arguments.into_iter().map(entry));
    }
    section.push_str(&flags(command.get_arguments().filter(|arg| !arg.is_positional() && !arg.is_global_set())));
    let below = command.get_subcommands().filter(|command| command.get_name() != "help");
    section.extend(below.map(|command| self::section(command, &format!("{name} "))));
    section
}

/// Flags in lists, one below each heading, in the order of the headings' first flags.
fn flags<'a>(flags: impl Iterator<Item = &'a Arg>) -> String {
    let mut lists: Vec<(&str, String)> = Vec::new();
    for flag in flags.filter(|flag| !matches!(flag.get_action(), ArgAction::Help | ArgAction::Version)) {
        let heading = flag.get_help_heading().unwrap_or(OPTIONS);
        match lists.iter_mut().find(|(known, _)| *known == heading) {
            Some((_, list)) => list.push_str(&entry(flag)),
            None => lists.push((heading, entry(flag))),
        }
    }
    lists.iter().map(|(heading, list)| format!("\n### {heading}\n\n{list}")).collect()
}

/// An argument or flag: how it is written, what it does, and what it is unless given.
fn entry(arg: &Arg) -> String {
    let takes_value = arg.get_action().takes_values();
    let values = arg.get_value_names().unwrap_or_default().join(" ");
    let mut names = Vec::new();
    names.extend(arg.get_short().map(|short| format!("-{short}")));
    names.extend(arg.get_long().map(|long| format!("--{long}")));
    if let Some(last) = names.last_mut().filter(|_| takes_value) {
        let _ = write!(last, " {values}");
    }
    if arg.is_positional() {
        names.push(values);
    }
    let names = names.iter().map(|name| format!("`{name}`")).collect::<Vec<_>>().join(", ");
    let help = arg.get_long_help().or_else(|| arg.get_help()).map(ToString::to_string).unwrap_or_default();
    let mut entry = item(&format!("{names}: {help}"), "");
    if takes_value {
        for value in arg.get_possible_values().iter().filter(|value| !value.is_hide_set()) {
            let help = value.get_help().map(|help| format!(": {help}")).unwrap_or_default();
            entry.push_str(&item(&format!("`{}`{help}", value.get_name()), "  "));
        }
        entry.push_str(&notes(arg));
    }
    entry
}

/// What else is to be said of a value: whether it may be given again, what it is unless given, and where it can come
/// from.
fn notes(arg: &Arg) -> String {
    let mut notes = Vec::new();
    if matches!(arg.get_action(), ArgAction::Append) {
        notes.push("May be given several times.".to_owned());
    }
    let defaults: Vec<_> = arg.get_default_values().iter().map(|value| value.to_string_lossy()).collect();
    if !defaults.is_empty() {
        notes.push(format!("Unless given: `{}`.", defaults.join(",")));
    }
    notes.extend(arg.get_env().map(|name| format!("Environment: `{}`.", name.to_string_lossy())));
    if notes.is_empty() { String::new() } else { format!("\n{}", folded(&notes.join(" "), "  ")) }
}

/// A list's item of one or more paragraphs.
pub(super) fn item(paragraphs: &str, indent: &str) -> String {
    let whole = text_of(paragraphs, &format!("{indent}  "));
    format!("{indent}- {}", whole.trim_start())
}

/// Help in paragraphs.
fn text(help: Option<&StyledStr>, indent: &str) -> String {
    text_of(&help.map(ToString::to_string).unwrap_or_default(), indent)
}

pub(super) fn text_of(paragraphs: &str, indent: &str) -> String {
    paragraphs.split("\n\n").map(|paragraph| folded(paragraph, indent)).collect::<Vec<_>>().join("\n")
}

/// A paragraph in lines of at most [`WIDEST`] columns.
fn folded(paragraph: &str, indent: &str) -> String {
    // At the start of a line these would begin a list or a heading.
    let is_mark =
        |word: &str| matches!(word, "-" | "+" | "*" | "#") || word.ends_with('.') && word.parse::<f64>().is_ok();
    let mut lines: Vec<String> = Vec::new();
    for word in paragraph.split_whitespace() {
        match lines.last_mut() {
            Some(line) if is_mark(word) || line.chars().count() + 1 + word.chars().count() <= WIDEST => {
                line.push(' ');
                line.push_str(word);
            }
            _ => lines.push(format!("{indent}{word}")),
        }
    }
    lines.iter().map(|line| format!("{line}\n")).collect()
}
