/** Builds elements. Text only ever goes through text nodes, so names from the network cannot become markup. */

export type Child = Node | string

type Properties<Tag extends keyof HTMLElementTagNameMap> = Partial<
  Omit<HTMLElementTagNameMap[Tag], 'attributes' | 'style' | 'dataset' | 'classList' | 'children'>
> & {
  /** Attributes, for those that have no property (aria-*, role). */
  attributes?: Record<string, string>
}

export function element<Tag extends keyof HTMLElementTagNameMap>(
  tag: Tag,
  properties: Properties<Tag> = {},
  ...children: Child[]
): HTMLElementTagNameMap[Tag] {
  const { attributes, ...rest } = properties
  const node = document.createElement(tag)
  Object.assign(node, rest)
  for (const [name, value] of Object.entries(attributes ?? {})) {
    node.setAttribute(name, value)
  }
  node.append(...children)
  return node
}

let lastId = 0

/** An id that is unique in the page, to tie labels to controls. */
export function uniqueId(prefix: string): string {
  lastId += 1
  return `${prefix}-${lastId}`
}

/** Writes text only if it differs: unchanged text costs no layout and is not read out again. */
export function setText(node: HTMLElement, text: string): void {
  if (node.textContent !== text) {
    node.textContent = text
  }
}
