"""Tuning by hand, in the browser: ``flexhinf studio``.

::

    a slider ─► server, page ─► session ─► worker ─► preview ─► drawing, tiles ─► figures and arm in the browser
                controls                             the functions of design

`server.serve` answers at 127.0.0.1 alone. Each tab has a `session.Session`: a robot, a specification, and what was
computed of them last. `preview` computes, stage by stage, with the functions of `flexhinf.designs`; `worker` runs the
stages beside the event loop, those of the latest request of each tab. `controls` says which fields have a slider.
`page` lays out `elements` and `tiles`; `drawing` packs arrays for figure.js and arm.js, which draw. Files are named
within one folder, see `folder`.
"""
