//! The paper's figures from what was gathered, each with its caption.

use super::beyond::{Beyond, PUSH_AT_SECS, PUSH_NS, SLOPE_DEG, STEP_M, Shown};
use super::claims::paper;
use super::curves::{Band, Curve, WINDOW, band};
use super::gather::{ConstantGait, Gathered, Lacking, Trained, best};
use super::play::FRAME_SECS;
use super::settings::Settings;
use super::strips::{self, Eye, Pace, Strip};
use crate::report::chart::{Chart, Colour, Mark, Panel, Shape};
use crate::report::svg::Scale;
use herd_actor::env::PUSH_SECS;
use herd_actor::film::Frame;
use herd_actor::gait::{advance, lift};
use herd_common::config::task::Constant;
use herd_common::episode::Ending;

/// A figure with what to say of it.
pub(super) struct Figure {
    /// Its file's name without ending.
    pub(super) name: &'static str,
    /// Above it.
    pub(super) title: String,
    /// Below it.
    pub(super) caption: String,
    /// The drawing.
    pub(super) svg: String,
}

/// Points of a swing's curve.
const SWING_POINTS: usize = 200;
/// Beyond this ratio of episodes, the shorter training would be a sliver: the axis goes by decades.
const WIDE: f64 = 3.0;

/// All figures, in the paper's order, then what goes beyond it.
pub(super) fn all(gathered: &Gathered, settings: &Settings) -> Vec<Figure> {
    let (swing, limit_secs) = (&settings.base.task.constant, settings.base.task.episode_secs);
    let mut figures = vec![
        figure_3(swing),
        figure_4(gathered),
        figure_5(gathered, limit_secs),
        figure_6(gathered, limit_secs),
        figure_7(gathered),
        beyond(&gathered.beyond, swing),
    ];
    figures.extend(ablations(&gathered.ablations));
    figures
}

/// The swing of a foot by eq 15.
fn figure_3(gait: &Constant) -> Figure {
    let (stride, height, duration) = (gait.stride_m, gait.lift_m, gait.step_secs);
    let curve = |of: &dyn Fn(f64) -> (f64, f64)| -> Curve {
        (0..=SWING_POINTS).map(|i| of(i as f64 / SWING_POINTS as f64)).collect()
    };
    let over_time = |order: usize, y_label: &str, title: &str| {
        let scale = [1.0, duration, duration.powi(2)][order];
        let x = curve(&|s| (s * duration, stride * advance(s)[order] / scale));
        let z = curve(&|s| (s * duration, height * lift(s)[order] / scale));
        panel(
            title,
            "time into the swing (s)",
            y_label,
            vec![Mark::line("x, forwards", Colour::Blue, x), Mark::line("z, up", Colour::Orange, z)],
        )
    };
    let path = curve(&|s| (stride * advance(s)[0], height * lift(s)[0]));
    let panels = vec![
        panel("(a) path of the foot", "x (m)", "z (m)", vec![Mark::line("", Colour::Blue, path)]),
        over_time(0, "position (m)", "(b) position"),
        over_time(1, "velocity (m/s)", "(c) velocity"),
        over_time(2, "acceleration (m/s²)", "(d) acceleration"),
    ];
    Figure {
        name: "figure-3-swing",
        title: "Figure 3 · the swing of a foot".into(),
        caption: format!(
            "Equation 15 for S = {stride} m, H = {height} m, Δt = {duration} s, with its height corrected: as printed it \
             jumps at mid-swing and ends at H. Velocity and acceleration vanish at both ends, as the paper says."
        ),
        svg: Chart { panels }.to_svg(),
    }
}

/// Gaits as strips.
fn figure_4(gathered: &Gathered) -> Figure {
    let untrained = Some(("untrained planner".to_owned(), gathered.untrained.frames.as_slice()));
    let strips: Vec<Strip<'_>> = [
        (untrained, Colour::Green),
        (named("Group_0, torques: its best", best(gathered.torques())), Colour::Orange),
        (named("Group_1, planner over MPC: its best", best(gathered.gaits())), Colour::Blue),
    ]
    .into_iter()
    .filter_map(|(named, colour)| named.map(|(name, frames)| level_strip(name, frames, colour)))
    .collect();
    Figure {
        name: "figure-4-gaits",
        title: "Figure 4 · gaits".into(),
        caption: "Side views from the right, x forwards, all to one scale. Above, poses on one ground, older ones paler: \
                  from the start, while they fit. Below, one after the other with the camera on the trunk; ticks on the \
                  ground are 0.1 m apart. A full foot carries load, an open one is in the air; the left legs are grey."
            .into(),
        svg: strips::draw(&strips),
    }
}

fn level_strip(name: String, frames: &[Frame], colour: Colour) -> Strip<'_> {
    Strip { name, frames, colour, ground: &[], eye: Eye::Right, pace: Pace::FAST, push: None }
}

/// The pictures of a training under the name of its group and seed.
fn named<'a>(group: &str, trained: Option<&'a Trained>) -> Option<(String, &'a [Frame])> {
    trained.map(|trained| (format!("{group}, seed {}", trained.seed), trained.measured.frames.as_slice()))
}

/// A robot of figures 5 and 6: name, colour, pictures.
type Walker<'a> = (String, Colour, &'a [Frame]);

/// All three.
fn walkers(gathered: &Gathered) -> Vec<Walker<'_>> {
    let groups = [
        (named("Group_0", best(gathered.torques())), Colour::Orange),
        (named("Group_1", best(gathered.gaits())), Colour::Blue),
    ];
    let groups = groups.into_iter().filter_map(|(group, colour)| group.map(|(name, frames)| (name, colour, frames)));
    let constant = ("best constant gait".to_owned(), Colour::Green, gathered.constant.measured.frames.as_slice());
    [constant].into_iter().chain(groups).collect()
}

/// One figure of the walks over time; a walk that ends before the time limit ends in a dot.
fn over_time(walkers: &[Walker<'_>], limit_secs: f64, [title, y_label]: [&str; 2], of: fn(&Frame) -> f64) -> Panel {
    let line = |(name, colour, frames): &Walker<'_>| {
        Mark::line(name, *colour, frames.iter().map(|frame| (frame.secs, of(frame))).collect())
    };
    let fall = |(_, colour, frames): &Walker<'_>| {
        let last = frames.last().filter(|last| last.secs + FRAME_SECS < limit_secs)?;
        let dot = Shape::Dots(vec![(last.secs, of(last))]);
        Some(Mark { name: String::new(), colour: *colour, shape: dot })
    };
    let falls = walkers.iter().filter_map(fall);
    panel(title, "time (s)", y_label, walkers.iter().map(line).chain(falls).collect())
}

/// The centre of mass.
fn figure_5(gathered: &Gathered, limit_secs: f64) -> Figure {
    let walkers = walkers(gathered);
    let panels = vec![
        over_time(&walkers, limit_secs, ["(a) forwards", "x (m)"], |frame| frame.centre[0]),
        over_time(&walkers, limit_secs, ["(b) sideways", "y (m)"], |frame| frame.centre[1]),
        over_time(&walkers, limit_secs, ["(c) height", "z (m)"], |frame| frame.centre[2]),
    ];
    let ms = FRAME_SECS * 1e3;
    Figure {
        name: "figure-5-centre-of-mass",
        title: "Figure 5 · centre of mass".into(),
        caption: format!(
            "The whole robot's centre of mass in the world, every {ms:.0} ms of the first evaluation episode. A line that \
             ends in a dot ends in a fall. The paper's Group_0 slows down and drifts sideways, its Group_1 keeps its speed."
        ),
        svg: Chart { panels }.to_svg(),
    }
}

/// Roll and pitch.
fn figure_6(gathered: &Gathered, limit_secs: f64) -> Figure {
    let walkers = walkers(gathered);
    let panels = vec![
        over_time(&walkers, limit_secs, ["(a) roll", "roll (rad)"], |frame| frame.angles[0]),
        over_time(&walkers, limit_secs, ["(b) pitch", "pitch (rad)"], |frame| frame.angles[1]),
    ];
    let ((roll_1, roll_0), (pitch_1, pitch_0)) = (paper::ROLL, paper::PITCH);
    Figure {
        name: "figure-6-roll-pitch",
        title: "Figure 6 · roll and pitch".into(),
        caption: format!(
            "The same episodes. The paper gives variances: roll {roll_0:.1e} (Group_0) and {roll_1:.1e} (Group_1) rad², \
             pitch {pitch_0:.1e} and {pitch_1:.1e} rad²; ours are in the tables."
        ),
        svg: Chart { panels }.to_svg(),
    }
}

/// Return while learning.
fn figure_7(gathered: &Gathered) -> Figure {
    let curves = |of: fn(&Trained) -> Curve| {
        (gathered.torques().map(of).collect::<Vec<_>>(), gathered.gaits().map(of).collect::<Vec<_>>())
    };
    let groups = |(torque, gait): &(Vec<Curve>, Vec<Curve>)| {
        let both = [("Group_0", Colour::Orange, band(torque)), ("Group_1", Colour::Blue, band(gait))];
        both.into_iter().flat_map(|(name, colour, band)| banded(name, colour, &band)).collect::<Vec<_>>()
    };
    let with_paper = |mut marks: Vec<Mark>| {
        marks.push(Mark::level("paper, Group_1", Colour::Blue, paper::GAIT_RETURN));
        marks.push(Mark::level("paper, Group_0", Colour::Orange, paper::TORQUE_RETURN));
        marks
    };
    let (episodes, transitions) = (curves(Trained::over_episodes), curves(Trained::over_transitions));
    let end = |curves: &[Curve]| curves.iter().filter_map(|curve| curve.last()).map(|(x, _)| *x).fold(1.0, f64::max);
    let ratio = end(&episodes.0) / end(&episodes.1);
    let x_scale = if (1.0 / WIDE..=WIDE).contains(&ratio) { Scale::Linear } else { Scale::Decades };
    let (return_label, transitions_label) = ("return (eq 10, no unit)", "transitions (decisions learned from)");
    let near = panel(
        "(c) the same, near the paper's values",
        transitions_label,
        return_label,
        with_paper(groups(&transitions)),
    );
    let mut over_episodes = groups(&episodes);
    over_episodes.push(evaluations("Group_1 without noise", gathered.gaits()));
    over_episodes.push(best_constant(&gathered.constant));
    let mut panels = vec![
        Panel { x_scale, ..panel("(a) over episodes", "episode", return_label, over_episodes) },
        panel("(b) over transitions", transitions_label, return_label, groups(&transitions)),
        Panel { y_range: Some((-50.0, 250.0)), ..near },
    ];
    let rough = gathered.rough.as_ref().map(|rough| {
        let mut marks =
            banded("Group_1", Colour::Blue, &band(&rough.gaits.iter().map(Trained::over_episodes).collect::<Vec<_>>()));
        marks.push(evaluations("without noise", rough.gaits.iter()));
        marks.push(best_constant(&rough.constant));
        panel("(d) on rough ground", "episode", return_label, marks)
    });
    panels.extend(rough);
    let n = gathered.pairs.len();
    Figure {
        name: "figure-7-return",
        title: "Figure 7 · return while learning".into(),
        caption: format!(
            "Returns of training episodes, exploration noise included, averaged over {WINDOW} episodes. Lines are medians \
             of {n} seeds, areas reach from the lowest to the highest. Episodes of the two groups differ in length, so \
             (b) and (c) compare what was learned from: Group_0 was trained on at least as many transitions. Dots are \
             evaluations without noise while training goes on, of all seeds."
        ),
        svg: Chart { panels }.to_svg(),
    }
}

/// The evaluations of some trainings over episodes; those of untrained policies are left out.
fn evaluations<'a>(name: &str, trained: impl Iterator<Item = &'a Trained>) -> Mark {
    let all = trained.flat_map(|trained| &trained.evaluations).filter(|evaluation| evaluation.version > 0);
    let dots = all.map(|evaluation| (evaluation.version as f64, evaluation.mean_return)).collect();
    Mark { name: name.to_owned(), colour: Colour::Blue, shape: Shape::Dots(dots) }
}

/// What the best constant gait earns, to compare with.
fn best_constant(constant: &ConstantGait) -> Mark {
    Mark::level("best constant gait", Colour::Green, constant.measured.evaluation.value.mean)
}

/// The constant gait of the configuration where the paper does not go.
fn beyond(beyond: &Beyond, gait: &Constant) -> Figure {
    // Poses of the stroboscope stand this far apart, m: a trunk and a little.
    let strobe = (0.29 / gait.velocity_mps.abs().max(0.05)).max(FRAME_SECS);
    let pace = Pace { strobe, film_from: 3.0, film: 0.06 };
    let edge = first_edge(&beyond.steps).unwrap_or(0.0);
    let before_edge = beyond.steps.frames.iter().find(|frame| frame.centre[0] > edge - 0.16).map_or(0.0, |f| f.secs);
    let strips = [
        on_ground(&format!("up a slope of {SLOPE_DEG:.0}°"), &beyond.slope, pace),
        on_ground(
            &format!("over steps of {:.0} mm, up and down every 0.5 m", STEP_M * 1e3),
            &beyond.steps,
            Pace { film_from: before_edge, film: 0.1, ..pace },
        ),
        Strip {
            eye: Eye::Behind,
            push: Some((PUSH_AT_SECS, PUSH_SECS)),
            ..on_ground(
                &format!("pushed to the left by {PUSH_NS} N·s in {:.0} ms, from behind", PUSH_SECS * 1e3),
                &beyond.push,
                Pace { film_from: PUSH_AT_SECS - 0.1, film: 0.1, ..pace },
            )
        },
    ];
    Figure {
        name: "beyond-the-paper",
        title: "Beyond the paper · slope, steps, push".into(),
        caption: format!(
            "No policy, but the constant gait of the configuration: v_x {} m/s, S {} m, H {} m, Δt {} s, which is told \
             nothing of the ground. Drawn as in Figure 4, with the ground as it is. Seen from behind, front legs are grey, \
             the camera follows the trunk, and the ticks that pass below it are 0.1 m apart; the arrow is the push.",
            gait.velocity_mps, gait.stride_m, gait.lift_m, gait.step_secs
        ),
        svg: strips::draw(&strips),
    }
}

fn on_ground<'a>(name: &str, shown: &'a Shown, pace: Pace) -> Strip<'a> {
    let fate = match shown.ending {
        Ending::TimedOut => format!("{:.1} m in {:.0} s, no fall", shown.distance_m, shown.seconds),
        _ => format!("falls after {:.1} s", shown.seconds),
    };
    let name = format!("{name} · {fate}");
    Strip { ground: &shown.ground, pace, ..level_strip(name, &shown.frames, Colour::Green) }
}

/// Where the ground ahead first goes up by half a step, m.
fn first_edge(shown: &Shown) -> Option<f64> {
    shown.ground.iter().find(|(x, z)| *x > 0.0 && *z > STEP_M / 2.0).map(|(x, _)| *x)
}

/// Each ablation beside the default.
fn ablations(lacking: &[Lacking]) -> Option<Figure> {
    let (default, others) = lacking.split_first()?;
    let of = |lacking: &Lacking| band(&lacking.runs.iter().map(Trained::over_transitions).collect::<Vec<_>>());
    let panels = others.iter().map(|other| {
        let name = other.ablation.as_ref().map_or("", |ablation| ablation.name);
        let marks = banded("default", Colour::Grey, &of(default)).into_iter().chain(banded(
            "changed",
            Colour::Blue,
            &of(other),
        ));
        panel(name, "transitions", "return (eq 10, no unit)", marks.collect())
    });
    let panels = panels.collect();
    Some(Figure {
        name: "ablations",
        title: "The default learner with one part changed".into(),
        caption: format!("Training returns averaged over {WINDOW} episodes, as in Figure 7."),
        svg: Chart { panels }.to_svg(),
    })
}

/// A band with its median.
fn banded(name: &str, colour: Colour, band: &Band) -> Vec<Mark> {
    let area = band.x.iter().zip(&band.low).zip(&band.high).map(|((x, low), high)| (*x, *low, *high)).collect();
    let median = band.x.iter().copied().zip(band.median.iter().copied()).collect();
    vec![Mark { name: String::new(), colour, shape: Shape::Band(area) }, Mark::line(name, colour, median)]
}

fn panel(title: &str, x_label: &str, y_label: &str, marks: Vec<Mark>) -> Panel {
    let [title, x_label, y_label] = [title, x_label, y_label].map(str::to_owned);
    Panel { title, x_label, y_label, x_scale: Scale::Linear, y_range: None, marks }
}
