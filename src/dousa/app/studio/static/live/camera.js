// The camera of this machine: pictures of it go to the studio one after the other, over one connection.

import { language } from "../core/dom.js";
import { Problem } from "../core/api.js";

const [LONGEST, QUALITY] = [640, 0.8]; // px of what is looked at; more tells the networks nothing

export class Camera {
  constructor(video) {
    this.video = video;
    this.canvas = document.createElement("canvas");
  }

  /** Ask for the camera; -> [width, height] of what is looked at. */
  async open() {
    if (!navigator.mediaDevices) throw new Error(location.origin);
    this.stream = await navigator.mediaDevices.getUserMedia({ video: { width: { ideal: 1280 }, height: { ideal: 720 }, facingMode: "user" }, audio: false });
    this.video.srcObject = this.stream;
    await this.video.play();
    const { videoWidth: width, videoHeight: height } = this.video;
    const factor = Math.min(1, LONGEST / Math.max(width, height));
    Object.assign(this.canvas, { width: Math.round(width * factor), height: Math.round(height * factor) });
    return [this.canvas.width, this.canvas.height];
  }

  /** The picture of now as JPEG. */
  take() {
    this.canvas.getContext("2d").drawImage(this.video, 0, 0, this.canvas.width, this.canvas.height);
    return new Promise((resolve) => this.canvas.toBlob(resolve, "image/jpeg", QUALITY));
  }

  close() {
    for (const track of this.stream?.getTracks() ?? []) track.stop();
    this.video.srcObject = null;
    this.stream = null;
  }
}

/** Send a picture; -> what was found in it. */
export async function sendPicture(session, picture, seconds, signal) {
  const response = await fetch(`/api/live/${session}/picture?seconds=${seconds.toFixed(3)}`, {
    method: "POST",
    body: picture,
    signal,
    headers: { "accept-language": language, "content-type": "image/jpeg" },
    credentials: "same-origin",
  });
  const answer = await response.json();
  if (!response.ok) throw new Problem(answer.problem ?? String(response.status), response.status);
  return answer;
}
