/* The scene, in flash. */
    .section .rodata.scene, "a"
    .global scene_begin, scene_end
scene_begin:
    .incbin NERF_SCENE
scene_end:
    .section .note.GNU-stack, "", %progbits
