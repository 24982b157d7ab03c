"""The 3D player of one or two figures, and moving miniatures of motions: what report and studio put into their pages.

The player is a script of ours without dependencies, in parts that share one scope; `read_player_script` joins
them. A page needs an element, the style, the script and the data::

    dousa.createPlayer(element, data)  // see the top of player.js for its methods
    dousa.createMiniature(canvas, bytes)  // see the top of miniatures.js
    dousa.createClock()  // see the top of clock.js
"""
