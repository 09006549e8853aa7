//! The bench suites: the one place from which figures come.
//!
//! A suite is a function that draws or builds built-in scenes and returns rows; `brickfell bench` writes the rows of all
//! suites to `bench.json` and `bench.csv`. Times are medians; counters (nodes, samples, reads, bytes) do not depend on the
//! machine. Runs on one thread; what is measured may use more.

pub mod agreement;
pub mod builder;
pub mod cache;
pub mod caster;
pub mod culler;
pub mod effort;
mod filter_scenes;
pub mod filters;
pub mod lights;
pub mod pager;
mod scenes;
pub mod sight;
pub mod trees;
pub mod truth;
pub mod uploads;

use std::path::{Path, PathBuf};

use serde::Serialize;
use serde_json::{Map, Value, json};

use crate::commands::CommandError;
use crate::commands::input_args::InputArgs;

/// A row of a suite: named values in a fixed order.
pub type Row = Map<String, Value>;

/// What a suite is told.
#[derive(Clone, Copy, Debug)]
pub struct Settings<'a> {
    /// Where results go.
    pub out: &'a Path,
    /// Where built scenes are kept between runs.
    pub folder: &'a Path,
    /// The user's own scene, to be looked at instead of the built-in ones by suites that can.
    pub own: Option<&'a OwnScene>,
    /// Fewer repetitions and smaller sweeps.
    pub quick: bool,
    /// Measure the CPU caster, too.
    pub cpu: bool,
}

/// A database and what it was built from.
#[derive(Clone, Debug)]
pub struct OwnScene {
    /// The database.
    pub folder: PathBuf,
    /// Its input.
    pub input: InputArgs,
}

/// A suite by name.
#[derive(Clone, Copy, Debug)]
pub struct Suite {
    /// Its name.
    pub name: &'static str,
    /// What it measures, one line.
    pub about: &'static str,
    /// Whether it draws, for which it needs a device.
    pub draws: bool,
    /// Runs it.
    pub run: fn(&Settings<'_>) -> Result<Vec<Row>, CommandError>,
}

/// All suites.
pub const SUITES: &[Suite] = &[
    Suite {
        name: "builder",
        about: "speed, memory and size of builds",
        draws: false,
        run: builder::rows,
    },
    Suite {
        name: "caster",
        about: "the GPU ray caster at its default setting",
        draws: true,
        run: caster::default_rows,
    },
    Suite {
        name: "caster-variants",
        about: "what its settings cost, and the CPU reference",
        draws: true,
        run: caster::variants,
    },
    Suite {
        name: "caster-trees",
        about: "what many trees cost, in view and out of it",
        draws: true,
        run: trees::rows,
    },
    Suite {
        name: "agreement",
        about: "the GPU's pictures against the CPU reference's",
        draws: true,
        run: agreement::rows,
    },
    Suite {
        name: "cache",
        about: "a flight with pools of parts of what it needs",
        draws: true,
        run: cache::rows,
    },
    Suite {
        name: "culler",
        about: "culling and ordering, few and many trees in view",
        draws: false,
        run: culler::rows,
    },
    Suite {
        name: "effort",
        about: "a flight at full effort, and in half its time",
        draws: true,
        run: effort::rows,
    },
    Suite {
        name: "filters",
        about: "error and memory of the builder's filters, against the truth",
        draws: false,
        run: filters::rows,
    },
    Suite {
        name: "lights",
        about: "price and error of shadows and of ambient occlusion",
        draws: true,
        run: lights::rows,
    },
    Suite {
        name: "first-sight",
        about: "how long a view takes that is jumped to",
        draws: true,
        run: sight::rows,
    },
    Suite {
        name: "pager",
        about: "flights over a procedural terrain: memory, reading, and how long until it is sharp",
        draws: false,
        run: pager::rows,
    },
    Suite {
        name: "pager-growth",
        about: "one view on terrains of 1, 10 and 100 times the area",
        draws: false,
        run: pager::growth,
    },
    Suite {
        name: "pager-rates",
        about: "what the pager's parts cost: queue, frame, reading, shutdown",
        draws: false,
        run: pager::rates::rows,
    },
    Suite {
        name: "truth",
        about: "time against error: pictures against the truth from the input",
        draws: true,
        run: truth::rows,
    },
    Suite {
        name: "uploads",
        about: "bricks into the pool by one buffer and a kernel, against a copy for each",
        draws: true,
        run: uploads::rows,
    },
];

/// Makes a row of something that serialises to an object.
pub(crate) fn row(value: impl Serialize) -> Result<Row, CommandError> {
    match serde_json::to_value(value)? {
        Value::Object(map) => Ok(map),
        other => Err(CommandError {
            message: format!("a row is an object, not {other}"),
            hint: None,
        }),
    }
}

/// `bench.json`: the machine and the suites' rows. `adapter` is the device's name, if it was asked for.
pub fn to_json(adapter: Option<&str>, suites: &[(String, Vec<Row>)]) -> Value {
    let cores = std::thread::available_parallelism().map_or(1, |n| n.get());
    let suites: Map<String, Value> = suites
        .iter()
        .map(|(name, rows)| (name.clone(), json!({ "rows": rows })))
        .collect();
    json!({
        "machine": {
            "os": std::env::consts::OS,
            "arch": std::env::consts::ARCH,
            "cores": cores,
            "adapter": adapter,
            "exact_filtering": std::env::var("GALLIVM_PERF").is_ok_and(|v| v.contains("no_aos_sampling")),
            "version": env!("CARGO_PKG_VERSION"),
        },
        "suites": suites,
    })
}

/// `bench.csv`: one line a row, led by its suite; the columns are all suites' keys, empty where a suite has no such key.
pub fn to_csv(suites: &[(String, Vec<Row>)]) -> String {
    let mut keys: Vec<&String> = Vec::new();
    for key in suites
        .iter()
        .flat_map(|(_, rows)| rows.iter().flat_map(|row| row.keys()))
    {
        if !keys.contains(&key) {
            keys.push(key);
        }
    }
    let text = |value: Option<&Value>| match value {
        None => String::new(),
        Some(Value::String(s)) => format!("\"{}\"", s.replace('"', "\"\"")),
        Some(other) => other.to_string(),
    };
    let mut out = keys
        .iter()
        .fold("suite".to_string(), |line, key| format!("{line},{key}"))
        + "\n";
    for (name, rows) in suites {
        for row in rows {
            out += &keys.iter().fold(name.clone(), |line, key| {
                format!("{line},{}", text(row.get(*key)))
            });
            out.push('\n');
        }
    }
    out
}

/// The rows of a suite as an aligned table for the terminal.
pub fn to_table(rows: &[Row]) -> String {
    let Some(first) = rows.first() else {
        return String::new();
    };
    let text = |value: &Value| match value {
        Value::String(s) => s.clone(),
        Value::Number(n) if n.is_f64() => format!("{:.3}", n.as_f64().unwrap_or(0.0)),
        other => other.to_string(),
    };
    let columns: Vec<Vec<String>> = first
        .keys()
        .map(|key| {
            std::iter::once(key.clone())
                .chain(rows.iter().map(|r| r.get(key).map_or(String::new(), text)))
                .collect()
        })
        .collect();
    let width = |column: &Vec<String>| column.iter().map(|c| c.chars().count()).max().unwrap_or(0);
    (0..=rows.len())
        .map(|k| {
            let cells: Vec<String> = columns
                .iter()
                .map(|c| format!("{:>1$}", c[k], width(c)))
                .collect();
            cells.join("  ") + "\n"
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn csv_and_table_hold_every_value() {
        let rows = vec![
            row(json!({"a": 1.5, "b": "x\"y"})).unwrap(),
            row(json!({"a": 22, "b": "z"})).unwrap(),
        ];
        let other = vec![row(json!({"c": 0.5, "b": "w"})).unwrap()];
        let suites = vec![("s".to_string(), rows.clone()), ("t".to_string(), other)];
        assert_eq!(
            to_csv(&suites),
            "suite,a,b,c\ns,1.5,\"x\"\"y\",\ns,22,\"z\",\nt,,\"w\",0.5\n"
        );
        assert_eq!(to_table(&rows), "    a    b\n1.500  x\"y\n   22    z\n");
        assert_eq!(to_json(Some("gpu"), &suites)["suites"]["s"]["rows"][1]["a"], 22);
        assert!(row(3).is_err());
    }
}
