//! Macros for errors: `errors!` declares an error enum with its messages; `ensure!` returns an error if a check fails.

/// Declares an error enum. A variant's message is the text of `Display`, and part of the variant's documentation.
macro_rules! errors {
    ($(#[$about:meta])* $error:ident: $(
        $(#[$doc:meta])* $name:ident $(($at:ident: $of:ty))? $({$($field:ident: $type:ty),+})?
            => $sentence:literal $(, $word:ident = $value:expr)*;
    )+) => {
        $(#[$about])*
        #[derive(Clone, Copy, Debug, PartialEq)]
        #[allow(missing_docs, reason = "a field's sentence says what it is")]
        #[non_exhaustive]
        pub enum $error {
            $(
                $(#[$doc])*
                #[doc = concat!("\n`` ", $sentence, " ``")]
                $name $(($of))? $({$($field: $type),+})?,
            )+
        }

        impl core::fmt::Display for $error {
            #[allow(unused_doc_comments, reason = "a variant's attributes say whether it is built")]
            fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
                match self {
                    $($(#[$doc])* Self::$name $(($at))? $({$($field),+})? => write!(f, $sentence $(, $word = $value)*),)+
                }
            }
        }

        impl core::error::Error for $error {}
    };
}
pub(crate) use errors;

/// If the condition `$holds` is false, returns `Err($error)` from the function in which the macro is used.
macro_rules! ensure {
    ($holds:expr, $error:expr) => {{
        let holds: bool = $holds;
        if !holds {
            return Err($error);
        }
    }};
}
pub(crate) use ensure;
