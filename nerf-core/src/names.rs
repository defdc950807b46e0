//! A macro that declares enums whose variants have names for command-line options and reports.

/// Declares an enum from its variants and their names, with the constant `ALL` (all variants) and the method `name`.
macro_rules! names {
    ($(#[$about:meta])* pub enum $choice:ident { $($(#[$doc:meta])* $variant:ident = $name:literal,)+ }) => {
        $(#[$about])*
        #[derive(Clone, Copy, Debug, PartialEq, Eq)]
        pub enum $choice {
            $($(#[$doc])* #[doc = concat!("\n`", $name, "`")] $variant,)+
        }

        impl $choice {
            /// All variants, in the order of declaration.
            pub const ALL: [Self; [$($name),+].len()] = [$(Self::$variant),+];

            /// Name of the variant in command-line options and reports.
            pub const fn name(self) -> &'static str {
                match self {
                    $(Self::$variant => $name,)+
                }
            }
        }
    };
}
pub(crate) use names;
