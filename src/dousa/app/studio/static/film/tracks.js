// The keypoints of everybody in a film, in pieces that are fetched when they are looked at.

import { get } from "../core/api.js";

const PIECE = 400; // frames
const SCALE = 16384;
const UNSEEN = -32768;

function bytes(text) {
  const raw = atob(text);
  return Uint8Array.from(raw, (letter) => letter.charCodeAt(0));
}

export class Tracks {
  /** onLoad() when a piece has come. */
  constructor(job, view, nNames, onLoad) {
    Object.assign(this, { job, view, nNames, onLoad, pieces: new Map() });
  }

  /** The piece of a frame, or null while it is on its way. */
  piece(frame) {
    const number = Math.floor(frame / PIECE);
    if (!this.pieces.has(number)) this.load(number);
    return this.pieces.get(number);
  }

  async load(number) {
    this.pieces.set(number, null);
    try {
      const came = await get(`/estimations/${this.job}/film/people/${this.view}`, { first: number * PIECE, count: PIECE });
      const points = new Int16Array(bytes(came.points).buffer);
      this.pieces.set(number, { ...came, points, sure: bytes(came.sure) });
      this.onLoad();
    } catch {
      // nobody was looked for yet, or the studio is away: asked for again with the next version
    }
  }

  /** Who is there in a frame: [{track, points: [[x, y] shares of the picture, or null], sure: [0..1]}]. */
  at(frame) {
    const piece = this.piece(frame);
    if (!piece) return [];
    const row = frame - piece.first;
    if (row < 0 || row >= piece.frames) return [];
    const found = [];
    for (let track = 0; track < piece.people; track += 1) {
      const start = (track * piece.frames + row) * this.nNames;
      const points = [];
      const sure = [];
      for (let k = start; k < start + this.nNames; k += 1) {
        const x = piece.points[2 * k];
        points.push(x === UNSEEN ? null : [x / SCALE, piece.points[2 * k + 1] / SCALE]);
        sure.push(piece.sure[k] / 255);
      }
      if (points.some(Boolean)) found.push({ track, points, sure });
    }
    return found;
  }
}
