//! Help texts of all commands.
use clap::{Arg, Command};

/// Maximum length of a description, in characters.
const MAX_DESCRIPTION: usize = 72;

/// Calls `visit` for every visible command with its path, such as `plumb topic echo`.
fn visit_commands(command: &Command, path: &str, visit: &mut dyn FnMut(&str, &Command)) {
    visit(path, command);
    for subcommand in command.get_subcommands().filter(|subcommand| !subcommand.is_hide_set()) {
        visit_commands(subcommand, &format!("{path} {}", subcommand.get_name()), visit);
    }
}

/// Returns the convention that a description violates, if any.
fn description_fault(text: &str) -> Option<&'static str> {
    let first = text.chars().next();
    if text.chars().count() > MAX_DESCRIPTION {
        Some("is longer than 72 characters")
    } else if text.ends_with('.') {
        Some("ends with a full stop")
    } else if text.contains('\n') {
        Some("has more than one line")
    } else if !first.is_some_and(|first| first.is_uppercase() || first.is_ascii_digit()) {
        Some("does not begin with a capital letter")
    } else {
        None
    }
}

/// Returns the commands below `Examples:` in the text after the options.
fn examples(command: &Command) -> Vec<String> {
    let text = command.get_after_help().map(ToString::to_string).unwrap_or_default();
    let lines = text.lines().skip_while(|line| *line != "Examples:").skip(1);
    lines.take_while(|line| !line.is_empty()).map(str::to_owned).collect()
}

/// Splits a line into words like a shell: quotes group words, and a comment ends the line.
fn shell_words(line: &str) -> Vec<String> {
    let (mut words, mut word, mut quote) = (Vec::new(), None::<String>, None);
    for c in line.chars() {
        match (c, quote) {
            (c, Some(open)) if c == open => quote = None,
            ('\'' | '"', None) => {
                quote = Some(c);
                word.get_or_insert_default();
            }
            (' ', None) => words.extend(word.take()),
            ('#', None) if word.is_none() => break,
            (c, _) => word.get_or_insert_default().push(c),
        }
    }
    words.extend(word);
    words
}

#[test]
fn descriptions_are_short_and_uniform() {
    let mut faults = Vec::new();
    visit_commands(&plumbline::command_line(), "plumb", &mut |path, command| {
        let about = command.get_about().map(ToString::to_string).unwrap_or_default();
        faults.extend(description_fault(&about).map(|fault| format!("{path}: {about:?} {fault}")));
        for argument in command.get_arguments().filter(|argument| !argument.is_hide_set()) {
            let help = argument.get_help().map(ToString::to_string).unwrap_or_default();
            let name = Arg::get_id(argument);
            faults.extend(description_fault(&help).map(|fault| format!("{path} {name}: {help:?} {fault}")));
            if argument.get_long_help().is_some() {
                faults.push(format!("{path} {name}: has a second help text"));
            }
        }
    });
    assert!(faults.is_empty(), "{}", faults.join("\n"));
}

#[test]
fn every_command_has_examples_that_parse() {
    let (mut faults, mut count) = (Vec::new(), 0);
    visit_commands(&plumbline::command_line(), "plumb", &mut |path, command| {
        let lines = examples(command);
        if !(2..=3).contains(&lines.len()) {
            faults.push(format!("{path}: {} examples instead of 2 or 3", lines.len()));
        }
        for line in lines {
            count += 1;
            if !line.trim_start().starts_with(path) {
                faults.push(format!("{path}: {line:?} is an example of another command"));
            }
            if let Err(error) = plumbline::command_line().try_get_matches_from(shell_words(&line)) {
                faults.push(format!("{path}: {line:?}: {error}"));
            }
        }
    });
    assert!(faults.is_empty(), "{}", faults.join("\n"));
    assert!(count > 60, "{count} examples");
}

#[test]
fn help_fits_a_terminal_of_80_columns() {
    visit_commands(&plumbline::command_line(), "plumb", &mut |path, _| {
        let words = path.split(' ').chain(["--help"]);
        let help = plumbline::command_line().try_get_matches_from(words).unwrap_err().to_string();
        for line in help.lines() {
            assert!(line.chars().count() <= 80, "{path}: {line}");
        }
    });
}

/// The arguments have the same meaning in all commands: a launch file is never positional, and a
/// running system is selected by its name or by its launch file. The exception is `plumb demo`,
/// which has a built-in launch file.
#[test]
fn launch_and_system_are_alike_in_all_commands() {
    let (mut faults, mut with_launch, mut with_system) = (Vec::new(), 0, 0);
    visit_commands(&plumbline::command_line(), "plumb", &mut |path, command| {
        let option = |long: &str| command.get_arguments().find(|argument| argument.get_long() == Some(long));
        let (launch, system) = (option("launch"), option("system"));
        with_launch += usize::from(launch.is_some());
        with_system += usize::from(system.is_some());
        let value = |argument: Option<&Arg>| argument.and_then(Arg::get_value_names).map(|names| names[0].to_string());
        if value(launch).is_some_and(|name| name != "FILE") || value(system).is_some_and(|name| name != "NAME") {
            faults.push(format!("{path}: --launch FILE or --system NAME is called otherwise"));
        }
        if system.is_some() && launch.is_none() && path != "plumb demo" {
            faults.push(format!("{path}: has --system, but not --launch"));
        }
        for positional in command.get_positionals() {
            let help = positional.get_help().map(ToString::to_string).unwrap_or_default();
            if help.contains("aunch file") {
                faults.push(format!("{path}: {help:?} is not an option"));
            }
        }
    });
    assert!(faults.is_empty(), "{}", faults.join("\n"));
    assert!(with_launch > 20 && with_system > 15, "{with_launch} with --launch, {with_system} with --system");
}

#[test]
fn shell_words_handles_quotes_and_comments() {
    assert_eq!(
        shell_words("  plumb up --source 'sim:s1?seed=2'  # a comment"),
        ["plumb", "up", "--source", "sim:s1?seed=2"]
    );
    assert_eq!(shell_words("a \"b c\" d#e ''"), ["a", "b c", "d#e", ""]);
}
