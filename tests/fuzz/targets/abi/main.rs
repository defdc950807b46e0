//! Sequences of calls through the C interface, with arguments no compiler checks.
//!
//! The host keeps its side of the contract, which is that pointers are NULL or point to what the
//! header says; nothing else. Then: no crash and no panic, canaries around all memory intact, what a
//! failed call would have written untouched, a message exactly where a call failed, and memory of
//! the size that was asked for is enough.
#![no_main]
#![allow(unsafe_code, reason = "the target calls the C interface")]

mod draw;
mod lent;
mod numbers;
mod planes;
mod points;
mod scenes;
mod settings;
mod workers;

use arbitrary::{Result, Unstructured};
use libfuzzer_sys::{Corpus, fuzz_target};
use scenes::Host;

fuzz_target!(|data: &[u8]| -> Corpus {
    let mut u = Unstructured::new(data);
    if host(&mut u).is_ok() { Corpus::Keep } else { Corpus::Reject }
});

fn host(u: &mut Unstructured<'_>) -> Result<()> {
    let mut hosts: Vec<Host> = Vec::new();
    for _ in 0..u.int_in_range(2..=10u8)? {
        if hosts.is_empty() || (hosts.len() < 3 && u.ratio(1, 6)?) {
            hosts.extend(scenes::open(u)?);
            continue;
        }
        let at = u.choose_index(hosts.len())?;
        let host = &hosts[at];
        let memory: Vec<Vec<u8>> = hosts.iter().map(|host| host.memory.bytes().to_vec()).collect();
        match u.int_in_range(0..=17u8)? {
            0..=3 => draw::render(&hosts, at, u)?,
            4 | 5 => draw::picture(&hosts, at, u)?,
            6 | 7 => points::query(&hosts, at, u)?,
            8 => points::cameras(u)?,
            9 => scenes::describe(host, u)?,
            10 => scenes::file(host, u)?,
            11 | 12 => settings::wish(host, u)?,
            13 => settings::pace(host, u)?,
            14 => settings::explain(&hosts, at, u)?,
            _ => points::rays(&hosts, at, u)?,
        }
        for (host, memory) in hosts.iter().zip(memory) {
            let intact = host.memory.surroundings_are_intact() && host.memory.bytes() == memory;
            assert!(intact, "a scene was written to");
        }
    }
    Ok(())
}
