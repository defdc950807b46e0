//! Macro that declares the methods of a type whose feature is off in this build, so that their callers compile.

/// Declares the methods of an enum without variants, from their signatures alone. The enum replaces a type whose
/// feature is off. The methods are never called, since the enum has no values.
macro_rules! absent {
    ($($(#[$about:meta])* $visibility:vis fn $name:ident $(<$V:ident: $Bound:ident>)?(&self $(, $argument:ty)*) -> $result:ty;)+) => {$(
        $(#[$about])*
        #[allow(missing_docs, reason = "the type with the feature has them")]
        $visibility fn $name $(<$V: $Bound>)?(&self $(, _: $argument)*) -> $result {
            match *self {}
        }
    )+};
}
pub(crate) use absent;
