/** Texts of the set-up page. */
export const words = {
  title: 'Connect cameras',
  lead:
    'Set each exposure so that walls are well seen. Lamps may saturate (red): their light is then taken from further exposures, ' +
    'or as a lower bound. The dashed circle is the rim of the fish-eye picture as it was found.',
  search: 'Search again',
  searching: 'Looking for cameras …',
  none: 'No camera was found.',
  inRoom: 'is in the room already',
  noPicture: 'Waiting for a picture …',
  pictureOf: (name: string) => `What ${name} sees; saturated pixels are red`,
  include: 'Into the room',
  name: 'Name',
  pixelFormat: 'Pixel format',
  exposure: 'Exposure',
  find: 'Find the exposure',
  field: 'Field of view',
  degrees: (value: number) => `${value}°`,
  saturated: 'Saturated',
  histogram: (saturated: string) => `Spread of the pixels from dark to bright, ${saturated} saturated`,
  room: {
    title: 'Room file',
    name: 'Name of the room',
    model: 'Model',
    noModel: 'Put the GLB of the room into the folder of the room file, then search again.',
    exists: (path: string, ids: string) =>
      `${path} is there (${ids || 'no cameras'}). The chosen cameras are added at its end; nothing else in it changes.`,
    isNew: (path: string) => `${path} will be written.`,
    write: 'Write the room file',
    add: 'Add to the room file',
    noneChosen: 'Choose at least one camera.',
    wrongName:
      'Names begin with a letter or digit and hold letters, digits, dots, dashes and underscores; each camera needs its own.',
    done: (path: string, cameras: string, next: string) =>
      `Written: ${path} with ${cameras}.\nThe lenses are guesses and the poses unknown: calibrate before you trust the light.\nNext: ${next}`,
  },
} as const
