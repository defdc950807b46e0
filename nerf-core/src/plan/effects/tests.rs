extern crate std;

use super::*;
use std::string::ToString;

/// Examples of effects. For each: the name of its feature, whether this build has the feature, and the effects.
fn each() -> [(&'static str, bool, Effects); 6] {
    let lens = ThinLens { aperture_radius: 0.1, focus_distance: 4.0 };
    let tone = |tone| Effects { tone, ..Effects::NONE };
    [
        ("jitter", cfg!(feature = "jitter"), Effects { jitter: Some(Jitter { seed: 7 }), ..Effects::NONE }),
        ("anti-aliasing", cfg!(feature = "anti-aliasing"), Effects { anti_aliasing: 2, ..Effects::NONE }),
        (
            "depth-of-field",
            cfg!(feature = "depth-of-field"),
            Effects { depth_of_field: Some(lens), ..Effects::NONE },
        ),
        ("tone-map", cfg!(feature = "tone-map"), tone(Tone { exposure: 1.0, ..Tone::NONE })),
        ("tone-map", cfg!(feature = "tone-map"), tone(Tone { map: ToneMap::Filmic, ..Tone::NONE })),
        ("tone-map", cfg!(feature = "tone-map"), tone(Tone { linear: true, ..Tone::NONE })),
    ]
}

#[test]
fn what_this_build_lacks_is_refused_by_the_name_of_its_feature() {
    assert_eq!(Effects::NONE.checked(), Ok(Effects::NONE));
    for (feature, built, effects) in each() {
        if built {
            assert_eq!(effects.checked(), Ok(effects), "{feature}");
        } else {
            let error = effects.checked().unwrap_err();
            assert_eq!(error, EffectError::NotBuilt { feature });
            assert!(error.to_string().contains(feature), "{error}");
        }
    }
}

#[test]
fn settings_out_of_range_are_refused_by_name() {
    for found in [0, 257, u16::MAX] {
        let error = Effects { anti_aliasing: found, ..Effects::NONE }.checked().unwrap_err();
        assert_eq!(error, EffectError::AntiAliasing { found });
        assert!(error.to_string().contains("anti_aliasing: expected 1 to 256"), "{error}");
    }
    let lens = |aperture_radius, focus_distance| Effects {
        depth_of_field: Some(ThinLens { aperture_radius, focus_distance }),
        ..Effects::NONE
    };
    for found in [-1e-9, 1.1e9, f32::INFINITY] {
        assert_eq!(lens(found, 1.0).checked(), Err(EffectError::Aperture { found }));
        assert_eq!(lens(1.0, found).checked(), Err(EffectError::Focus { found }));
    }
    assert_eq!(lens(1.0, 0.0).checked(), Err(EffectError::Focus { found: 0.0 }));
    assert!(lens(f32::NAN, 1.0).checked().unwrap_err().to_string().contains("aperture_radius"));
    assert!(lens(1.0, f32::NAN).checked().unwrap_err().to_string().contains("focus_distance"));
    let exposure = |exposure| Effects { tone: Tone { exposure, ..Tone::NONE }, ..Effects::NONE };
    for found in [-32.5, 33.0, f32::INFINITY] {
        assert_eq!(exposure(found).checked(), Err(EffectError::Exposure { found }));
    }
    assert!(exposure(f32::NAN).checked().unwrap_err().to_string().contains("exposure"));
}

#[test]
fn a_lens_without_aperture_is_a_pinhole_in_every_build() {
    // Without an aperture any focus distance is valid, even NaN.
    for focus_distance in [1.0, 0.0, f32::NAN] {
        let pinhole = Some(ThinLens { aperture_radius: 0.0, focus_distance });
        let effects = Effects { depth_of_field: pinhole, ..Effects::NONE };
        assert_eq!(effects.checked(), Ok(Effects::NONE));
    }
}
