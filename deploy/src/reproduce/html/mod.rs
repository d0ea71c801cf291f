//! The report as one page that needs nothing else: tables, drawings, readable on a phone and in the dark.

mod against;

use super::claims;
use super::figures::Figure;
use super::measure::{millis, unit_name};
use super::report::{Report, Run};
use crate::report::svg::escape;
use crate::table::{count, duration, percent};
use std::fmt::Write;

const STYLE: &str = include_str!("page.css");

/// The page.
pub(super) fn page(report: &Report<'_>, figures: &[Figure]) -> String {
    let mut body = format!("<h1>The paper's experiment, repeated</h1>\n{}", lead(report));
    body += &section("What the paper claims, and what came out", &claims_table(report));
    body += &section("Both readings of the reward", &readings(report));
    body += &section("Against the best constant gait", &against::section(report));
    let drawn = figures.iter().filter(|figure| figure.name != ABLATIONS).map(drawing).collect::<String>();
    body += &section("Figures", &drawn);
    body += &section("What it cost", &costs(report));
    if !report.ablations.is_empty() {
        let drawn = figures.iter().filter(|figure| figure.name == ABLATIONS).map(drawing).collect::<String>();
        body += &section("The default learner with one part changed", &(ablations(report) + &drawn));
    }
    body += &section("How it was done", &method(report));
    format!(
        "<!doctype html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n\
         <meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\n\
         <title>The paper's experiment, repeated</title>\n<style>\n{STYLE}</style>\n</head>\n<body>\n{body}</body>\n</html>\n"
    )
}

/// Name of the figure that stands in a section of its own.
const ABLATIONS: &str = "ablations";

fn section(title: &str, inside: &str) -> String {
    format!("<section>\n<h2>{}</h2>\n{inside}</section>\n", escape(title))
}

fn lead(report: &Report<'_>) -> String {
    let settings = report.settings;
    let held = report.claims.iter().filter(|claim| claim.holds()).count();
    let told = report.claims.iter().filter(|claim| claim.seeds > 0).count();
    let version = if settings.quick { " This is the small version: few episodes, so read it as a sketch." } else { "" };
    let text = format!(
        "Group_1 is DDPG planning gaits over an MPC, Group_0 is DDPG on joint torques; both were trained from scratch \
         with {} seeds, Group_1 for {} episodes each, Group_0 for as many transitions. Of {} claims that can be checked, \
         {held} hold on every seed.{version}",
        settings.seeds.len(),
        claims::spread(&report.group_1.iter().map(|run| run.cost.episodes as f64).collect::<Vec<_>>(), |x| count(
            x as u64
        )),
        told,
    );
    paragraph(&text)
}

fn claims_table(report: &Report<'_>) -> String {
    let rows = report.claims.iter().map(|claim| {
        let class = match claim.seeds {
            0 => "open",
            _ if claim.holds() => "holds",
            _ => "fails",
        };
        let cells = [&claim.text, &claim.paper, &claim.ours].map(|cell| format!("<td>{}</td>", escape(cell)));
        format!("<tr>{}<td class=\"{class}\">{}</td></tr>\n", cells.concat(), escape(&claim.verdict))
    });
    let fallen: Vec<String> = report
        .facts
        .iter()
        .filter(|facts| facts.torque.fall_rate > 0.0)
        .map(|facts| format!("{} with seed {}", percent(facts.torque.fall_rate), facts.seed))
        .collect();
    let caveat = if fallen.is_empty() {
        String::new()
    } else {
        paragraph(&format!(
            "Group_0 falls before its time is over in {} of its evaluation episodes. Its variances are over the time that it \
             stood; they are compared only where that was 2 s or more on average.",
            fallen.join(", ")
        ))
    };
    let head = ["claim", "paper", "ours: median (lowest to highest over seeds)", "verdict"];
    wrapped(&head, &rows.collect::<String>()) + &caveat
}

fn readings(report: &Report<'_>) -> String {
    let task = &report.settings.base.task;
    let sample_secs = task.reward.sample_secs;
    let names = report.facts.first().map(|facts| facts.gait.readings.named(sample_secs).map(|(name, _)| name));
    let rows = names.into_iter().flatten().enumerate().map(|(index, name)| {
        let of = |side: fn(&claims::Facts) -> &claims::Side| -> Vec<f64> {
            report.facts.iter().map(|facts| *side(facts).readings.named(sample_secs)[index].1).collect()
        };
        let (gait, torque) = (of(|facts| &facts.gait), of(|facts| &facts.torque));
        let on = gait.iter().zip(&torque).filter(|(gait, torque)| claims::beats(**gait, **torque)).count();
        let tell = |figures: &[f64]| claims::spread(figures, |x| format!("{x:.1}"));
        let ratio = claims::multiples(&gait, &torque, |x| format!("{x:.1}"));
        vec![name, tell(&gait), tell(&torque), ratio, format!("{on} of {}", gait.len())]
    });
    let head = ["eq 10 is", "Group_1", "Group_0", "ratio", "seeds on which Group_1 is 45 % above"];
    let one_sample = if task.torque.decision_secs == sample_secs {
        " A torque decision holds one sample, so for Group_0 both ways of paying differ only where a fall cuts the last one \
         short."
    } else {
        ""
    };
    let text = format!(
        "The paper leaves open how often equation 10 is paid and in which unit torques enter it. Both groups were trained \
         on it summed every {0} ms with {1}; the other readings are computed from the same evaluation episodes. Paid once \
         per decision, T_s stays {0} ms and r is that of the decision's end.{one_sample}",
        millis(sample_secs),
        unit_name(task.reward.torque_unit),
    );
    paragraph(&text) + &table(&head, rows)
}

fn costs(report: &Report<'_>) -> String {
    let rough = report.rough.as_ref().map(|rough| ("Group_1 on rough ground", &rough.group_1));
    let groups = [("Group_1", &report.group_1), ("Group_0", &report.group_0)].into_iter().chain(rough);
    let rows = groups.flat_map(|(group, runs)| {
        runs.iter().map(move |run| {
            let cost = &run.cost;
            vec![
                format!("{group}, seed {}", run.seed),
                count(cost.episodes),
                count(cost.transitions),
                count(cost.updates),
                duration(cost.simulated_secs),
                duration(cost.wall_secs),
                run.reached_175_at.map_or("never".to_owned(), |episode| format!("{episode:.0}")),
            ]
        })
    });
    let head = ["training", "episodes", "transitions", "updates", "simulated", "wall time", "episode that reached 175"];
    let text = format!(
        "Wall time is that of {} actor processes and a learner, with whatever else the machine was doing. A run of Group_0 \
         is made longer in rounds until it has at least the transitions of Group_1 with the same seed; what it has beyond \
         them speaks for Group_0.",
        report.settings.actors
    );
    paragraph(&text) + &table(&head, rows)
}

fn ablations(report: &Report<'_>) -> String {
    let rows = report.ablations.iter().map(|part| {
        let of = |figure: &dyn Fn(&Run<'_>) -> f64| part.runs.iter().map(figure).collect::<Vec<_>>();
        let whole = |x: f64| format!("{x:.0}");
        let reached: Vec<f64> = part.runs.iter().filter_map(|run| run.reached_175_at).collect();
        vec![
            part.name.to_owned(),
            part.sets.join(", "),
            part.runs.iter().map(|run| run.seed.to_string()).collect::<Vec<_>>().join(", "),
            if reached.is_empty() { "never".to_owned() } else { claims::spread(&reached, whole) },
            claims::spread(&of(&|run| run.last_training_return.unwrap_or(f64::NAN)), whole),
            claims::spread(&of(&|run| run.evaluation.value.mean), whole),
            claims::spread(&of(&|run| run.evaluation.fall_rate), percent),
        ]
    });
    let head = [
        "learner",
        "keys",
        "seeds",
        "episode that reached 175",
        "training return at the end",
        "return without noise",
        "falls",
    ];
    table(&head, rows)
}

fn method(report: &Report<'_>) -> String {
    let settings = report.settings;
    let seeds = settings.seeds.iter().map(ToString::to_string).collect::<Vec<_>>().join(", ");
    let text = format!(
        "Written by herd {} (commit {}), seeds {seeds}. Evaluations are {} episodes without noise, of at most {} s each, from starts that no \
         training and no search has seen; all policies and gaits get the same. Every training is a run of its own \
         (one learner, {} actors) with its configuration beside it. Numbers of every figure and table are in report.json.",
        report.version, report.commit, settings.evaluation_episodes, settings.base.task.episode_secs, settings.actors,
    );
    format!("{}<pre>herd {}</pre>\n", paragraph(&text), escape(&settings.command))
}

fn drawing(figure: &Figure) -> String {
    format!(
        "<figure>\n<h3>{}</h3>\n<div class=\"wide\">{}</div>\n<figcaption>{}</figcaption>\n</figure>\n",
        escape(&figure.title),
        figure.svg,
        escape(&figure.caption)
    )
}

fn heading(text: &str) -> String {
    format!("<h3>{}</h3>\n", escape(text))
}

fn paragraph(text: &str) -> String {
    format!("<p>{}</p>\n", escape(text))
}

fn table(head: &[&str], rows: impl Iterator<Item = Vec<String>>) -> String {
    let rows = rows.map(|row| {
        let cells: Vec<String> = row.iter().map(|cell| format!("<td>{}</td>", escape(cell))).collect();
        format!("<tr>{}</tr>\n", cells.concat())
    });
    wrapped(head, &rows.collect::<String>())
}

fn wrapped(head: &[&str], rows: &str) -> String {
    let mut html = String::from("<div class=\"wide\"><table>\n<thead><tr>");
    for cell in head {
        let _ = write!(html, "<th>{}</th>", escape(cell));
    }
    html + &format!("</tr></thead>\n<tbody>\n{rows}</tbody>\n</table></div>\n")
}
