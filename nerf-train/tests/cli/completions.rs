//! Completion scripts.

use crate::{fails, ok};

#[test]
fn completions_name_every_command() {
    for shell in ["bash", "zsh", "fish", "powershell", "elvish"] {
        let script = ok(["completions", shell]);
        for name in ["demo", "poses", "fit", "eval", "render", "inspect", "completions", "orbit"] {
            assert!(script.contains(name), "{shell}: {name}");
        }
    }
    fails(["completions", "tcsh"], &["bash", "zsh"]);
}
