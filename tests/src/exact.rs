//! Exact texture filtering for tests that compare pictures.
//!
//! lavapipe rounds filtered texels to 8 bits unless an environment variable, read when the driver starts, says otherwise. It
//! must not be set for the program itself, whose speed is measured, nor can a running process set its own. So a test binary
//! that was started without it runs itself once more with it, and each test reports what became of it there.

use std::env;
use std::process::Command;
use std::sync::OnceLock;

const VARIABLE: &str = "GALLIVM_PERF";
const EXACT: &str = "no_aos_sampling";

/// Arguments of a test binary that change how results are printed; the second run prints one line each.
const PRINTING: [&str; 5] = ["--nocapture", "--no-capture", "--show-output", "-q", "--quiet"];

/// Runs the body of the test with this name where filtering is exact.
///
/// # Panics
/// If it fails, here or there.
pub fn exactly(test: &str, body: impl FnOnce()) {
    static OUTPUT: OnceLock<String> = OnceLock::new();
    if env::var(VARIABLE).is_ok_and(|v| v.split(',').any(|flag| flag == EXACT)) {
        return body();
    }
    let output = OUTPUT.get_or_init(run_again);
    let line = format!("test {test} ... ok");
    assert!(
        output.lines().any(|l| l.starts_with(&line)),
        "{test} did not pass with {VARIABLE}={EXACT}:\n{output}"
    );
}

fn run_again() -> String {
    let arguments = env::args()
        .skip(1)
        .filter(|a| !PRINTING.contains(&a.as_str()) && !a.starts_with("--format"));
    let output = Command::new(env::current_exe().unwrap())
        .args(arguments)
        .env(VARIABLE, EXACT)
        .output()
        .unwrap();
    format!(
        "{}{}",
        String::from_utf8_lossy(&output.stdout),
        String::from_utf8_lossy(&output.stderr)
    )
}
