//! Laying one TOML text over another, strictly: a key must exist already and keep its type.

use super::Error;
use toml::{Table, Value};

/// The default configuration as a table.
pub fn default_table() -> Table {
    super::DEFAULT.parse().expect("the default configuration is TOML: tested")
}

/// Lays the TOML text `over` on `base`; `origin` names the text in errors.
pub fn overlay(base: &mut Table, over: &str, origin: &str) -> Result<(), Error> {
    let over: Table =
        over.parse().map_err(|e: toml::de::Error| Error::Syntax { origin: origin.into(), message: e.to_string() })?;
    overlay_table(base, over, "", origin)
}

/// Applies one `key=value`; the value is TOML, or else a bare string.
pub fn set(base: &mut Table, assignment: &str) -> Result<(), Error> {
    let origin = format!("--set {assignment}");
    let Some((path, value)) = assignment.split_once('=') else {
        return Err(Error::Syntax { origin, message: "expected key=value, such as ddpg.batch_size=128".into() });
    };
    let parsed = format!("v={value}").parse::<Table>().ok().and_then(|mut table| table.remove("v"));
    let value = parsed.unwrap_or_else(|| Value::String(value.to_owned()));
    let nested =
        path.trim().rsplit('.').fold(value, |inner, key| Value::Table(Table::from_iter([(key.to_owned(), inner)])));
    let Value::Table(over) = nested else { unreachable!("split yields at least one key") };
    overlay_table(base, over, "", &origin)
}

/// Every value with its dotted key, in order.
pub fn flatten(table: &Table) -> Vec<(String, String)> {
    let of = |(key, value): (&String, &Value)| match value {
        Value::Table(inner) => flatten(inner).into_iter().map(|(rest, v)| (format!("{key}.{rest}"), v)).collect(),
        value => vec![(key.clone(), value.to_string())],
    };
    table.iter().flat_map(of).collect()
}

fn overlay_table(base: &mut Table, over: Table, path: &str, origin: &str) -> Result<(), Error> {
    for (key, value) in over {
        let full = if path.is_empty() { key.clone() } else { format!("{path}.{key}") };
        let Some(slot) = base.get_mut(&key) else {
            let nearest = nearest(&key, base.keys()).map(|near| full[..full.len() - key.len()].to_owned() + near);
            return Err(Error::UnknownKey { origin: origin.into(), key: full, nearest });
        };
        match (slot, value) {
            (Value::Table(inner), Value::Table(over)) => overlay_table(inner, over, &full, origin)?,
            (slot @ Value::Float(_), Value::Integer(whole)) => *slot = Value::Float(whole as f64),
            (slot, value) if slot.same_type(&value) => *slot = widen(slot, value),
            (slot, value) => {
                let found = format!("{} {value}", value.type_str());
                let expected = slot.type_str().to_owned();
                return Err(Error::WrongType { origin: origin.into(), key: full, found, expected });
            }
        }
    }
    Ok(())
}

/// Turns whole numbers in a list into floats where the default has floats.
fn widen(slot: &Value, value: Value) -> Value {
    match (slot, value) {
        (Value::Array(old), Value::Array(new)) if matches!(old.first(), Some(Value::Float(_))) => Value::Array(
            new.into_iter().map(|x| x.as_integer().map_or(x, |whole| Value::Float(whole as f64))).collect(),
        ),
        (_, value) => value,
    }
}

fn nearest<'a>(key: &str, known: impl Iterator<Item = &'a String>) -> Option<&'a str> {
    known
        .map(|candidate| (strsim::jaro_winkler(key, candidate), candidate))
        .filter(|(likeness, _)| *likeness > 0.7)
        .max_by(|a, b| a.0.total_cmp(&b.0))
        .map(|(_, candidate)| candidate.as_str())
}
